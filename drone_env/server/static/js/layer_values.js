// Layers per cell: the best moves, the network's mistakes, and the range of the battery.
import { colourOf, font } from "./base.js";
import { middle, pointTo, STEP } from "./layer_flights.js";

const SMALL = 18;

function eachCell(rows, visit) {
  rows?.forEach((row, y) => row.forEach((item, x) => item !== null && visit(item, x, y)));
}

export function spanOf(values) {
  const all = values.flat().filter((value) => value !== null);
  return { most: Math.max(...all), least: Math.min(...all) };
}

/** Colours show what each cell loses against the best one; arrows are the best moves. */
export function drawValues(ctx, { stage, layout }) {
  const cells = stage.values?.answer?.cells;
  if (!cells?.values) return;
  const { most, least } = spanOf(cells.values);
  const { cell, left, top } = layout;
  ctx.globalAlpha = 0.5;
  eachCell(cells.values, (value, x, y) => {
    const lost = (100 * (most - value)) / (most - least || 1);
    const ends = lost < 50 ? ["--good", "--warn"] : ["--warn", "--bad"];
    ctx.fillStyle = `color-mix(in oklab, ${ends.map(colourOf).join(", ")} ${(2 * lost) % 100}%)`;
    ctx.fillRect(left + x * cell, top + y * cell, cell, cell);
  });
  ctx.globalAlpha = 0.8;
  ctx.fillStyle = ctx.strokeStyle = colourOf("--ink");
  eachCell(cells.best_actions, (actions, x, y) => actions.forEach((action) => drawMove(ctx, layout, action, x, y)));
  ctx.globalAlpha = 1;
}

export function drawNetwork(ctx, { stage, layout }) {
  const cells = stage.values?.answer?.cells;
  const { cell, left, top, scale } = layout;
  ctx.lineWidth = Math.max(1.5, 2 * scale);
  ctx.strokeStyle = ctx.fillStyle = colourOf("--bad");
  eachCell(cells?.disagree, (errs, x, y) => {
    if (!errs) return;
    ctx.strokeRect(left + (x + 0.08) * cell, top + (y + 0.08) * cell, cell * 0.84, cell * 0.84);
    drawMove(ctx, layout, cells.network_actions[y][x], x, y);
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

/** The cells in reach, with the battery units left there; only a faint shade while a visitor flies. */
export function drawRange(ctx, { stage, world, track, layout }) {
  const range = stage.values?.answer?.range;
  if (!range) return;
  const { cell, left, top, scale } = layout;
  range.forEach((row, y) =>
    row.forEach((units, x) => {
      ctx.fillStyle = colourOf(units === null ? "--ground" : "--good");
      const strength = units === null ? 0.55 : 0.06 + (0.34 * units) / world.battery_capacity;
      ctx.globalAlpha = track.byHand ? strength * 0.6 : strength;
      ctx.fillRect(left + x * cell, top + y * cell, cell, cell);
    }),
  );
  ctx.globalAlpha = 1;
  if (track.byHand || cell < SMALL * 1.8 * scale) return;
  ctx.fillStyle = colourOf("--ink");
  ctx.font = font(Math.round(cell * 0.26));
  ctx.textAlign = "right";
  ctx.textBaseline = "bottom";
  eachCell(range, (units, x, y) => ctx.fillText(String(units), left + (x + 0.94) * cell, top + (y + 0.98) * cell));
}
