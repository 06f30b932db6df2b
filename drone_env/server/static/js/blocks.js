// Large maps and real cities: adjacent cells of one kind are drawn as one block.
import { colourOf } from "./base.js";
import { drawFigure } from "./figures.js";
import { drawGrid, drawLabels, variety } from "./layer_city.js";

const TONES = 3;
export const isJoined = ({ width, height, task }) => width * height > 400 || Boolean(task.attribution);

/** The offsets of roofs and shadows, in cells. */
const HEIGHT = 0.16;
const SHADOW = 0.17;
/** Smaller cells, in CSS pixels, show no grid and no single trees. */
const FINE = 13;
const SMALLEST_SIGN = 12;

/** Paths in units of cells, cached per map. @type {WeakMap<object, object>} */
const shapes = new WeakMap();

export function drawBlocks(ctx, { world, layout, names }) {
  const { cell, left, top, scale } = layout;
  if (!shapes.has(world)) shapes.set(world, shapesOf(world, names));
  const { buildings, trees, crowns, obstacles, hatching, pads } = shapes.get(world);
  const fine = cell >= FINE * scale;
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
  outlined(obstacles, "--block-closed", "--block-hatch");
  ctx.save();
  ctx.clip(obstacles);
  ctx.lineWidth = Math.max(scale, 1) / cell;
  ctx.stroke(hatching);
  ctx.restore();
  outlined(trees, "--block-wood", "--block-crown");
  if (fine) paint(crowns, "--block-crown");
  // Roofs and shadows stay in the map, and roofs above their own cells.
  ctx.save();
  ctx.beginPath();
  ctx.rect(0, 0, world.width, world.height);
  ctx.clip();
  place(SHADOW, SHADOW);
  for (const tone of buildings) paint(tone, "--map-shade");
  ctx.restore();
  place();
  for (const tone of buildings) outlined(tone, "--block-wall", "--block-edge");
  buildings.forEach((tone, i) => {
    ctx.save();
    ctx.clip(tone);
    place(0, -HEIGHT);
    outlined(tone, `--block-roof-${i + 1}`, "--block-edge");
    ctx.restore();
  });
  ctx.setTransform(1, 0, 0, 1, 0, 0);
  ctx.globalAlpha = fine ? 0.35 : 0;
  drawGrid(ctx, world, layout);
  ctx.globalAlpha = 1;
  ctx.strokeRect(left - 0.5, top - 0.5, world.width * cell + 1, world.height * cell + 1);
  const side = Math.max(cell, SMALLEST_SIGN * scale);
  for (const [x, y] of pads) drawFigure(ctx, "pad", left + (x + 0.5) * cell, top + (y + 0.5) * cell, side);
  if (layout.labels) drawLabels(ctx, world, layout);
}

function shapesOf(world, names) {
  const { cells, width, height } = world;
  const tones = toneOfBlocks(world, names.indexOf("building"));
  const found = {
    buildings: Array.from({ length: TONES }, () => new Path2D()),
    trees: new Path2D(),
    crowns: new Path2D(),
    obstacles: new Path2D(),
    hatching: new Path2D(),
    pads: [],
  };
  for (let at = -height; at < width; at += 0.5) {
    found.hatching.moveTo(at, 0);
    found.hatching.lineTo(at + height, height);
  }
  const add = {
    building: (x, y) => found.buildings[tones[y * width + x]].rect(x, y, 1, 1),
    tree(x, y) {
      found.trees.rect(x, y, 1, 1);
      addCrowns(found.crowns, x, y);
    },
    obstacle: (x, y) => found.obstacles.rect(x, y, 1, 1),
    pad: (x, y) => found.pads.push([x, y]),
  };
  cells.forEach((row, y) => row.forEach((id, x) => add[names[id]]?.(x, y)));
  return found;
}

function addCrowns(path, x, y) {
  const some = variety(x, y);
  for (let i = 0; i < 3; i++) {
    const angle = (some % 63) / 10 + 2.1 * i;
    const radius = 0.12 + 0.02 * ((some >> (3 * i)) % 4);
    const [cx, cy] = [x + 0.5 + 0.21 * Math.cos(angle), y + 0.5 + 0.21 * Math.sin(angle)];
    path.moveTo(cx + radius, cy);
    path.arc(cx, cy, radius, 0, 2 * Math.PI);
  }
}

/** The tone of each building cell; connected cells have the same tone. */
function toneOfBlocks({ cells, width, height }, building) {
  const tones = new Int8Array(width * height).fill(-1);
  const isOne = (at) => tones[at] < 0 && cells[Math.floor(at / width)][at % width] === building;
  for (let start = 0; start < tones.length; start++) {
    const pending = isOne(start) ? [start] : [];
    const tone = variety(start % width, Math.floor(start / width)) % TONES;
    while (pending.length) {
      const at = pending.pop();
      if (!isOne(at)) continue;
      const x = at % width;
      const y = Math.floor(at / width);
      tones[at] = tone;
      if (x) pending.push(at - 1);
      if (x + 1 < width) pending.push(at + 1);
      if (y) pending.push(at - width);
      if (y + 1 < height) pending.push(at + width);
    }
  }
  return tones;
}
