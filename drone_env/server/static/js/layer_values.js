// Layers per cell: the best moves, and the range of the battery.
import { colourOf, font } from "./base.js";
import { ARROWS } from "./format.js";
import { middle, pointTo, STEP } from "./layer_flights.js";

/** The minimum size of a cell in CSS pixels that shows the units left there. */
const WRITTEN = 32;
/** The opacity of the colour of a cell that loses nothing, and what the largest loss adds: the map stays visible. */
const WASH = [0.1, 0.3];
/** The actions in the order of the values. */
const MOVES = Object.keys(ARROWS);
/** The sides of a cell: its neighbour, and the two corners. */
const SIDES = [
  [0, -1, 0, 0, 1, 0],
  [0, 1, 0, 1, 1, 1],
  [-1, 0, 0, 0, 0, 1],
  [1, 0, 1, 0, 1, 1],
];

function eachCell(rows, visit) {
  rows?.forEach((row, y) => row.forEach((item, x) => item !== null && visit(item, x, y)));
}

export function spanOf(values) {
  const all = values.flat().filter((value) => value !== null);
  return { most: Math.max(...all), least: Math.min(...all) };
}

/** Colours show what each cell loses against the best one, from blue to orange; arrows are the best moves. */
export function drawValues(ctx, { stage, layout }) {
  const cells = stage.values?.answer?.cells;
  if (!cells) return;
  const { most, least } = spanOf(cells.values);
  const { cell, left, top } = layout;
  eachCell(cells.values, (value, x, y) => {
    const lost = (most - value) / (most - least || 1);
    ctx.fillStyle = `color-mix(in oklab, ${colourOf("--best")}, ${colourOf("--worst")} ${100 * lost}%)`;
    ctx.globalAlpha = WASH[0] + WASH[1] * lost;
    ctx.fillRect(left + x * cell, top + y * cell, cell, cell);
    ctx.globalAlpha = 1;
    const after = cells.q_values[y][x] ?? [];
    MOVES.filter((_, i) => after[i] === value).forEach((action) => drawMove(ctx, layout, action, x, y));
  });
}

/** An arrow in a cell; a dot for WAIT. */
function drawMove(ctx, layout, action, x, y) {
  const { cell } = layout;
  const at = middle(layout, [x, y]);
  if (STEP[action]) {
    pointTo(ctx, action, ...at, cell * 0.12, cell * 0.3, cell * 0.11);
    return;
  }
  ctx.beginPath();
  ctx.arc(...at, cell * 0.09, 0, 2 * Math.PI);
  ctx.fill();
}

/** An outline between the cells in reach and the others, with the battery units left there unless a visitor flies. */
export function drawRange(ctx, { stage, world, track, layout, names }) {
  const range = stage.values?.answer?.range;
  if (!range) return;
  const { cell, left, top, scale } = layout;
  const { impassable } = world.task;
  ctx.beginPath();
  eachCell(range, (units, x, y) => {
    for (const [dx, dy, x1, y1, x2, y2] of SIDES) {
      if (range[y + dy]?.[x + dx] !== null || impassable.includes(names[world.cells[y + dy][x + dx]])) continue;
      ctx.moveTo(left + (x + x1) * cell, top + (y + y1) * cell);
      ctx.lineTo(left + (x + x2) * cell, top + (y + y2) * cell);
    }
  });
  ctx.lineCap = "round";
  const stroke = (width, colour) => {
    ctx.lineWidth = width * scale;
    ctx.strokeStyle = colourOf(colour);
    ctx.stroke();
  };
  stroke(5, "--map-ground");
  stroke(2.5, "--range");
  if (track.byHand || cell < WRITTEN * scale) return;
  ctx.fillStyle = colourOf("--ink");
  ctx.font = font(Math.round(cell * 0.26));
  ctx.textAlign = "right";
  ctx.textBaseline = "bottom";
  eachCell(range, (units, x, y) => ctx.fillText(String(units), left + (x + 0.94) * cell, top + (y + 0.98) * cell));
}
