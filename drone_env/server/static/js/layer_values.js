// What is known of each cell at a moment: what can still be reached from there, what the network would do, the battery's range.
import { colourOf, font } from "./base.js";
import { drawArrow } from "./figures.js";
import { STEP } from "./layer_flights.js";

const SMALL = 18;

function eachCell(rows, visit) {
  rows?.forEach((row, y) => row.forEach((item, x) => item !== null && visit(item, x, y)));
}

/** The greener a cell, the more is still possible from it; its arrows are the moves that give nothing away. */
export function drawValues(ctx, { stage, layout }) {
  const cells = stage.values?.answer?.cells;
  if (!cells?.values) return;
  const all = cells.values.flat().filter((value) => value !== null);
  const least = Math.min(...all);
  const spread = Math.max(...all) - least || 1;
  const { cell, left, top } = layout;
  ctx.fillStyle = colourOf("--good");
  eachCell(cells.values, (value, x, y) => {
    ctx.globalAlpha = 0.04 + 0.46 * ((value - least) / spread);
    ctx.fillRect(left + x * cell, top + y * cell, cell, cell);
  });
  ctx.globalAlpha = 0.8;
  ctx.fillStyle = ctx.strokeStyle = colourOf("--ink");
  eachCell(cells.best_actions, (actions, x, y) => actions.forEach((action) => drawMove(ctx, layout, action, x, y)));
  ctx.globalAlpha = 1;
}

/** The network's move where that gives something away. */
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

/** One move in the middle of a cell; waiting is a dot. */
function drawMove(ctx, { cell, left, top }, action, x, y) {
  const [cx, cy] = [left + (x + 0.5) * cell, top + (y + 0.5) * cell];
  if (action === "WAIT") {
    ctx.beginPath();
    ctx.arc(cx, cy, cell * 0.09, 0, 2 * Math.PI);
    ctx.fill();
    return;
  }
  const [dx, dy] = STEP[action];
  drawArrow(ctx, cx + dx * cell * 0.12, cy + dy * cell * 0.12, cx + dx * cell * 0.42, cy + dy * cell * 0.42, cell * 0.11);
}

/** What lies within the battery's range, with the units left there. */
export function drawRange(ctx, { stage, world, layout }) {
  const range = stage.values?.answer?.range;
  if (!range) return;
  const { cell, left, top, scale } = layout;
  range.forEach((row, y) =>
    row.forEach((units, x) => {
      ctx.fillStyle = colourOf(units === null ? "--ground" : "--good");
      ctx.globalAlpha = units === null ? 0.55 : 0.06 + (0.34 * units) / world.capacity;
      ctx.fillRect(left + x * cell, top + y * cell, cell, cell);
    }),
  );
  ctx.globalAlpha = 1;
  ctx.lineWidth = Math.max(2, 2.5 * scale);
  ctx.strokeStyle = colourOf("--good");
  outline(ctx, layout, range);
  if (cell < SMALL * 1.8 * scale) return;
  ctx.fillStyle = colourOf("--ink");
  ctx.font = font(Math.round(cell * 0.26));
  ctx.textAlign = "right";
  ctx.textBaseline = "bottom";
  eachCell(range, (units, x, y) => ctx.fillText(String(units), left + (x + 0.94) * cell, top + (y + 0.98) * cell));
}

/** The border of the cells that are reached. */
function outline(ctx, { cell, left, top }, rows) {
  const reached = (x, y) => rows[y]?.[x] !== undefined && rows[y][x] !== null;
  ctx.beginPath();
  eachCell(rows, (_, x, y) => {
    const [x0, y0, x1, y1] = [left + x * cell, top + y * cell, left + (x + 1) * cell, top + (y + 1) * cell];
    const side = (dx, dy, ...line) => {
      if (reached(x + dx, y + dy)) return;
      ctx.moveTo(line[0], line[1]);
      ctx.lineTo(line[2], line[3]);
    };
    side(-1, 0, x0, y0, x0, y1);
    side(1, 0, x1, y0, x1, y1);
    side(0, -1, x0, y0, x1, y0);
    side(0, 1, x0, y1, x1, y1);
  });
  ctx.stroke();
}
