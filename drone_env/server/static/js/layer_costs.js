// What cells cost in battery units: beside the drone of a visitor who flies, and of the cell under the pointer.
import { colourOf, font } from "./base.js";
import { el } from "./dom.js";
import { ARROWS, cellName, counted, isLost, points } from "./format.js";
import { STEP } from "./layer_flights.js";

const LEAST_CELL = 16;

/** The kind of a cell at a frame, whether it is closed, the units of a step there, and those that a wait charges. */
export function cellAt({ task, cells }, names, frame, x, y) {
  const kind = frame.delivered.some(([px, py]) => px === x && py === y) ? "delivered" : names[cells[y][x]];
  const charge = kind === "pad" ? task.charge_rate : 0;
  return { kind, closed: task.impassable.includes(kind), units: task.drain[kind], charge };
}

/** The cost of each neighbouring cell while the visitor flies: its units, or a cross; on a pad, the charge of a wait. */
export function drawCosts(ctx, { world, track, layout, clock, names }) {
  const { cell, left, top, scale } = layout;
  const { task } = world;
  const equal = !task.pads && !task.impassable.length && Object.values(task.drain).every((units) => units === 1);
  if (!track.byHand || equal || clock.cursor < track.steps || cell < LEAST_CELL * scale) return;
  const frame = track.last;
  const high = Math.max(Math.min(15 * scale, cell * 0.65), cell * 0.24);
  ctx.font = font(Math.round(high * 0.78), 500);
  ctx.textAlign = "center";
  ctx.textBaseline = "middle";
  for (const [dx, dy] of [...Object.values(STEP), [0, 0]]) {
    const [x, y] = [frame.x + dx, frame.y + dy];
    if (!world.cells[y]?.[x] && world.cells[y]?.[x] !== 0) continue;
    const { closed, units, charge } = cellAt(world, names, frame, x, y);
    const waits = !dx && !dy;
    if (waits && !charge) continue;
    const text = closed ? "×" : waits ? `+${charge}` : String(units);
    const wide = Math.max(high, ctx.measureText(text).width + high * 0.5);
    const at = [left + x * cell + 2 * scale, top + y * cell + 2 * scale];
    ctx.fillStyle = colourOf(closed ? "--bad" : waits ? "--good" : "--ink");
    ctx.beginPath();
    ctx.roundRect(...at, wide, high, high / 2);
    ctx.fill();
    ctx.fillStyle = colourOf("--ground");
    ctx.fillText(text, at[0] + wide / 2, at[1] + high * 0.54);
  }
}

/** A note at the cell under the pointer or the finger: what it is, and what it costs. @param {Context} context */
export function mountCellNote(field, context) {
  const note = el("p.cell-note", { "aria-hidden": "true", hidden: true });
  field.append(note);
  let view = null;
  context.on("drawn", (drawn) => (view = drawn));
  const hide = () => (note.hidden = true);

  function show({ clientX, clientY }) {
    if (!view) return;
    const { world, track, layout, clock } = view;
    const { cell, left, top, scale } = layout;
    const box = field.getBoundingClientRect();
    const x = Math.floor(((clientX - box.left) * scale - left) / cell);
    const y = Math.floor(((clientY - box.top) * scale - top) / cell);
    note.hidden = world.cells[y]?.[x] === undefined;
    if (note.hidden) return;
    const values = context.shows("values") && context.stage.answer?.cells?.q_values?.[y][x];
    const cost = inWords(cellAt(world, context.names, track.frameAt(clock.cursor), x, y));
    note.replaceChildren(el("span", cost), ...(values ? movesIn(values) : []));
    const right = x > world.width / 2;
    note.style.setProperty("left", `${(left + (x + (right ? 0 : 1)) * cell) / scale}px`);
    note.style.setProperty("top", `${(top + (y + 0.5) * cell) / scale}px`);
    note.classList.toggle("before", right);
  }
  field.addEventListener("pointermove", (event) => event.pointerType === "mouse" && !event.buttons && show(event));
  field.addEventListener("click", show);
  field.addEventListener("pointerleave", ({ pointerType }) => pointerType === "mouse" && hide());
  context.stage.on("cursor", hide);
}

function movesIn(values) {
  const lost = (value) => Math.max(...values) - value;
  return Object.values(ARROWS).map((arrow, i) =>
    el("span", `${arrow} ${points(values[i])}`, isLost(lost(values[i])) ? `, loses ${points(lost(values[i]))}` : ""),
  );
}

export function inWords({ kind, closed, units, charge }) {
  if (closed) return `${cellName(kind)}: closed`;
  return `${cellName(kind)}: costs ${counted(units, "unit")}${charge ? `, each wait charges ${charge}` : ""}`;
}
