// The fixed parts of the map: ground, grid, numbers and figures.
import { colourOf, font } from "./base.js";
import { el } from "./dom.js";
import { drawFigure } from "./figures.js";
import { middle } from "./layer_flights.js";

const SMALLEST_SIGN = 14;

/** Whether adjacent cells of one kind are drawn as one block: on large maps and in real cities. */
export const isJoined = ({ width, height, task }) => width * height > 400 || Boolean(task.attribution);

export function drawCity(ctx, { world, layout, names }) {
  const { cell, left, top } = layout;
  ctx.fillStyle = colourOf("--map-ground");
  ctx.fillRect(left, top, world.width * cell, world.height * cell);
  drawGrid(ctx, world, layout);
  const { width, height } = ctx.canvas;
  const scenery = el("canvas", { width, height }).getContext("2d");
  eachFigure(scenery, { world, layout, names }, ["building", "tree"], cell);
  // Only the figures take the tint.
  scenery.globalCompositeOperation = "source-atop";
  scenery.fillStyle = colourOf("--map-tint");
  scenery.fillRect(0, 0, width, height);
  ctx.drawImage(scenery.canvas, 0, 0);
  if (layout.labels) drawLabels(ctx, world, layout);
}

/** Above the layers of the cells, which would dim them: pads and barricades. */
export function drawSigns(ctx, view) {
  const { cell, scale } = view.layout;
  eachFigure(ctx, view, isJoined(view.world) ? ["pad"] : ["pad", "obstacle"], Math.max(cell, SMALLEST_SIGN * scale));
}

function eachFigure(ctx, { world, layout, names }, kinds, side) {
  world.cells.forEach((row, y) =>
    row.forEach((id, x) => {
      if (kinds.includes(names[id])) drawFigure(ctx, names[id], ...middle(layout, [x, y]), side, variety(x, y));
    }),
  );
}

/** A fixed pseudo-random number for a cell. */
export const variety = (x, y) => Math.imul(x * 977 + y * 331 + 7, 2654435761) >>> 16;

export function drawGrid(ctx, world, { cell, left, top, scale }) {
  ctx.strokeStyle = colourOf("--map-grid");
  const line = Math.max(1, Math.round(scale));
  ctx.lineWidth = line;
  const half = (line % 2) / 2;
  ctx.beginPath();
  for (let x = 1; x < world.width; x++) {
    ctx.moveTo(left + x * cell + half, top);
    ctx.lineTo(left + x * cell + half, top + world.height * cell);
  }
  for (let y = 1; y < world.height; y++) {
    ctx.moveTo(left, top + y * cell + half);
    ctx.lineTo(left + world.width * cell, top + y * cell + half);
  }
  ctx.stroke();
  ctx.strokeStyle = colourOf("--map-edge");
  ctx.strokeRect(left - half, top - half, world.width * cell + 2 * half, world.height * cell + 2 * half);
}

export function drawLabels(ctx, world, { cell, left, top, scale }) {
  ctx.fillStyle = colourOf("--map-label");
  ctx.font = font(11 * scale);
  ctx.textAlign = "center";
  ctx.textBaseline = "alphabetic";
  for (let x = 0; x < world.width; x++) ctx.fillText(String(x), left + (x + 0.5) * cell, top - 6 * scale);
  ctx.textAlign = "right";
  ctx.textBaseline = "middle";
  for (let y = 0; y < world.height; y++) ctx.fillText(String(y), left - 6 * scale, top + (y + 0.53) * cell);
}
