// Large maps and real cities: adjacent cells of one kind are drawn as one block; real places have names and a scale.
import { colourOf, font } from "./base.js";
import { drawGrid, drawLabels } from "./layer_city.js";

/** The offsets of roofs and shadows, in cells. */
const HEIGHT = 0.16;
const SHADOW = 0.17;
/** Smaller cells, in CSS pixels, show no grid. */
const FINE = 13;
/** The lengths of scales in metres, and the maximum length of one in CSS pixels. */
const METRES = [10, 20, 50, 100, 200, 500, 1000];
const LONGEST = 110;

export function drawBlocks(ctx, { world, layout, names }) {
  const { cell, left, top, scale } = layout;
  const { building, tree, obstacle, hatching } = shapesOf(world, names);
  // Whole pixels avoid seams between cells.
  const place = (dx = 0, dy = 0) => ctx.setTransform(cell, 0, 0, cell, left + Math.round(dx * cell), top + Math.round(dy * cell));
  const paint = (path, colour) => {
    ctx.fillStyle = colourOf(colour);
    ctx.fill(path);
  };
  /** Fills a block over its stroke, which stays visible as an outline. */
  const outlined = (path, colour, edge) => {
    ctx.lineWidth = (2 * Math.max(scale, 1)) / cell;
    ctx.strokeStyle = colourOf(edge);
    ctx.stroke(path);
    paint(path, colour);
  };
  ctx.lineJoin = "round";
  place();
  ctx.fillStyle = colourOf("--block-street");
  ctx.fillRect(0, 0, world.width, world.height);
  outlined(obstacle, "--block-closed", "--block-hatch");
  ctx.save();
  ctx.clip(obstacle);
  ctx.lineWidth = Math.max(scale, 1) / cell;
  ctx.stroke(hatching);
  ctx.restore();
  outlined(tree, "--block-wood", "--block-crown");
  // Roofs and shadows stay in the map, and roofs above their own cells.
  ctx.save();
  ctx.beginPath();
  ctx.rect(0, 0, world.width, world.height);
  ctx.clip();
  place(SHADOW, SHADOW);
  paint(building, "--map-shade");
  ctx.restore();
  place();
  outlined(building, "--block-wall", "--block-edge");
  ctx.save();
  ctx.clip(building);
  place(0, -HEIGHT);
  outlined(building, "--block-roof", "--block-edge");
  ctx.restore();
  ctx.setTransform(1, 0, 0, 1, 0, 0);
  ctx.globalAlpha = cell >= FINE * scale ? 0.35 : 0;
  drawGrid(ctx, world, layout);
  ctx.globalAlpha = 1;
  ctx.strokeRect(left - 0.5, top - 0.5, world.width * cell + 1, world.height * cell + 1);
  if (layout.labels) drawLabels(ctx, world, layout);
}

/** Paths in units of cells. */
function shapesOf({ cells, width, height }, names) {
  const found = {};
  for (const name of ["building", "tree", "obstacle", "hatching"]) found[name] = new Path2D();
  for (let at = -height; at < width; at += 0.5) {
    found.hatching.moveTo(at, 0);
    found.hatching.lineTo(at + height, height);
  }
  cells.forEach((row, y) => row.forEach((id, x) => found[names[id]]?.rect(x, y, 1, 1)));
  return found;
}

/** Names that cover no other one; those of districts are in capital letters. */
export function drawNames(ctx, { world, layout }) {
  const { cell, left, top, scale } = layout;
  const taken = [];
  ctx.textAlign = "center";
  ctx.textBaseline = "middle";
  ctx.lineJoin = "round";
  ctx.strokeStyle = colourOf("--block-street");
  ctx.lineWidth = 3 * scale;
  for (const [name, x, y, angle] of world.task.names) {
    const text = angle === null ? name.toUpperCase() : name;
    const turn = ((angle ?? 0) * Math.PI) / 180;
    const size = (angle === null ? 12 : 11) * scale;
    ctx.font = font(size);
    const half = ctx.measureText(text).width / 2;
    const along = [-1, -0.5, 0, 0.5, 1].map((share) => ({
      px: x * cell + share * half * Math.cos(turn),
      py: y * cell + share * half * Math.sin(turn),
    }));
    const covers = ({ px, py }) => taken.some((other) => Math.hypot(px - other.px, py - other.py) < 2 * size);
    const leaves = ({ px, py }) => Math.min(px, py) < 0 || px > world.width * cell || py > world.height * cell;
    if (along.some((point) => covers(point) || leaves(point))) continue;
    taken.push(...along);
    ctx.save();
    ctx.translate(left + x * cell, top + y * cell);
    ctx.rotate(turn);
    ctx.strokeText(text, 0, 0);
    ctx.fillStyle = colourOf(angle === null ? "--ink" : "--ink-2");
    ctx.fillText(text, 0, 0);
    ctx.restore();
  }
}

/** In the lower left corner of what is seen: a length in metres, and an arrow to the north. */
export function drawScale(ctx, { world, layout, size }) {
  const { cell, left, top, scale } = layout;
  const metres = METRES.findLast((length) => (length / world.task.cell) * cell <= LONGEST * scale);
  if (!metres) return;
  const long = (metres / world.task.cell) * cell;
  ctx.save();
  ctx.translate(Math.max(left, 0) + 8 * scale, Math.min(top + world.height * cell, size.height) - 8 * scale);
  ctx.scale(scale, scale);
  const wide = long / scale;
  ctx.globalAlpha = 0.85;
  ctx.fillStyle = colourOf("--ground");
  ctx.beginPath();
  ctx.roundRect(0, -34, wide + 42, 34, 4);
  ctx.fill();
  ctx.globalAlpha = 1;
  ctx.fillStyle = ctx.strokeStyle = colourOf("--ink");
  ctx.lineWidth = 2;
  ctx.lineCap = ctx.lineJoin = "miter";
  ctx.stroke(new Path2D(`M8 -12v6h${wide}v-6`));
  ctx.fill(new Path2D(`M${wide + 25} -30l6 12l-6 -3l-6 3z`));
  ctx.font = font(12);
  ctx.textAlign = "center";
  ctx.textBaseline = "alphabetic";
  ctx.fillText(`${metres} m`, 8 + wide / 2, -16);
  ctx.fillText("N", wide + 25, -5);
  ctx.restore();
}
