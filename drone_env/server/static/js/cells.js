// What a cell is and costs: a note under the pointer, and the map in words.
import { announce, el } from "./dom.js";
import { ARROWS, cellName, counted, isLost, points } from "./format.js";
import { STEP } from "./layer_flights.js";

/** `Road: costs 1 unit`, or null outside the map. */
function inWords({ task, cells }, names, frame, x, y) {
  if (cells[y]?.[x] === undefined) return null;
  const kind = frame.delivered.some(([px, py]) => px === x && py === y) ? "delivered" : names[cells[y][x]];
  if (task.impassable.includes(kind)) return `${cellName(kind)}: closed`;
  const charge = kind === "pad" && task.charge_rate ? `, each wait charges ${task.charge_rate}` : "";
  return `${cellName(kind)}: costs ${counted(task.drain[kind], "unit")}${charge}`;
}

/** A note at the cell under the pointer or the finger. @param {Context} context */
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
    const words = inWords(world, context.names, track.frameAt(clock.cursor), x, y);
    note.hidden = words === null;
    if (note.hidden) return;
    const values = context.shows("values") && context.stage.answer?.cells?.q_values?.[y][x];
    note.replaceChildren(el("span", words), ...(values ? movesIn(values) : []));
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

/** Where everything is, and what a visitor who flies meets at each move. @param {HTMLDetailsElement} details @param {Context} context */
export function mountTextMap(details, context) {
  const { stage, names } = context;
  const list = details.querySelector("dl");
  details.addEventListener("toggle", write);
  let said = null;

  /** The cells beside the drone: `Up: Road: costs 1 unit. Right: edge of the map. ...`. */
  const around = ({ world, frame }) =>
    Object.entries(STEP)
      .map(([action, [dx, dy]]) => {
        const words = inWords(world, names, frame, frame.x + dx, frame.y + dy);
        return `${cellName(action.toLowerCase())}: ${words ?? "edge of the map"}.`;
      })
      .join(" ");

  function write() {
    const { world, track, frame } = stage;
    if (!details.open || !frame) return;
    const here = inWords(world, names, frame, frame.x, frame.y);
    const rows = [[track.name, `${at([frame.x, frame.y])}. ${here}`], ["Around it", around(stage)], ...placesOf(names, world, frame)];
    list.replaceChildren(...rows.map(([name, text]) => el("div", el("dt", { text: name }), el("dd", { text }))));
  }

  function say() {
    const { world, track } = stage;
    if (!track?.byHand || said === track.last) return;
    said = track.last;
    const { x, y, battery_units: units, event, message } = said;
    const news = ["step", "wait", null].includes(event) ? "" : `${message} `;
    announce(`${news}Column ${x}, row ${y}. Battery ${units} of ${world.battery_capacity}. ${around(stage)}`);
  }

  stage.on("change", () => {
    write();
    say();
  });
}

const at = ([x, y]) => `column ${x}, row ${y}`;

/** Where the parcels, the pads and the closed cells are. */
function placesOf(names, { task, cells, parcels }, { target, delivered }) {
  const gone = new Set(delivered.map(String));
  const listed = (places) => places.map(at).join("; ") || "none";
  const of = (wanted) => cells.map((row) => row.flatMap((id, x) => (wanted(names[id]) ? [x] : [])));
  const pads = of((kind) => kind === "pad").flatMap((columns, y) => columns.map((x) => [x, y]));
  const closed = of((kind) => task.impassable.includes(kind)).flatMap((columns, y) =>
    columns.length ? [`row ${y}: ${columns.length > 1 ? "columns" : "column"} ${columns.join(", ")}`] : [],
  );
  return [
    ["Target", target ? at(target) : "none"],
    ["Parcels to deliver", listed(parcels.filter((parcel) => !gone.has(String(parcel))))],
    ["Delivered", listed(delivered)],
    ...(task.pads ? [["Pads", listed(pads)]] : []),
    ...(closed.length ? [["Closed", closed.join("; ")]] : []),
  ];
}
