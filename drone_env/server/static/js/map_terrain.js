// What does not move: the ground, its grid and numbers, and what stands on it. Drawn once per map, size and theme.
import { drawFigure } from "./figures.js";

/**
 * @typedef {Object} Layout Where the grid lies on the canvas, in device pixels.
 * @property {number} cell Side of a cell, whole.
 * @property {number} left @property {number} top Corner of cell [0, 0].
 * @property {number} scale Device pixels per CSS pixel.
 * @property {boolean} labels Whether there is room for the numbers of columns and rows.
 */

/** @param {CanvasRenderingContext2D} ctx @param {Layout} layout @param {string[]} names Kinds of cells by id. */
export function drawTerrain(ctx, mission, layout, names, colours) {
  const { cell, left, top } = layout;
  const field = [left, top, mission.width * cell, mission.height * cell];
  ctx.fillStyle = colours.map.ground;
  ctx.fillRect(...field);
  drawGrid(ctx, mission, layout, colours);
  mission.cells.forEach((row, y) =>
    row.forEach((kind, x) =>
      drawFigure(ctx, names[kind], left + (x + 0.5) * cell, top + (y + 0.5) * cell, cell, variety(x, y)),
    ),
  );
  ctx.fillStyle = colours.map.night;
  ctx.fillRect(...field);
  if (layout.labels) drawLabels(ctx, mission, layout, colours);
}

/** A number that belongs to a cell: the same city always looks the same. */
const variety = (x, y) => Math.imul(x * 977 + y * 331 + 7, 2654435761) >>> 16;

function drawGrid(ctx, mission, { cell, left, top, scale }, colours) {
  ctx.strokeStyle = colours.map.grid;
  const line = Math.max(1, Math.round(scale));
  ctx.lineWidth = line;
  const half = (line % 2) / 2;
  ctx.beginPath();
  for (let x = 1; x < mission.width; x++) {
    ctx.moveTo(left + x * cell + half, top);
    ctx.lineTo(left + x * cell + half, top + mission.height * cell);
  }
  for (let y = 1; y < mission.height; y++) {
    ctx.moveTo(left, top + y * cell + half);
    ctx.lineTo(left + mission.width * cell, top + y * cell + half);
  }
  ctx.stroke();
  ctx.strokeStyle = colours.map.edge;
  ctx.strokeRect(left - half, top - half, mission.width * cell + 2 * half, mission.height * cell + 2 * half);
}

function drawLabels(ctx, mission, { cell, left, top, scale }, colours) {
  ctx.fillStyle = colours.map.label;
  ctx.font = `500 ${11 * scale}px ${colours.font}`;
  ctx.textAlign = "center";
  ctx.textBaseline = "alphabetic";
  for (let x = 0; x < mission.width; x++) ctx.fillText(String(x), left + (x + 0.5) * cell, top - 6 * scale);
  ctx.textAlign = "right";
  ctx.textBaseline = "middle";
  for (let y = 0; y < mission.height; y++) ctx.fillText(String(y), left - 6 * scale, top + (y + 0.53) * cell);
}
