// Large maps and real places from above: the cells of one kind that touch each other are one shape with one outline.
import { drawFigure } from "./figures.js";
import { drawGrid, drawLabels, variety } from "./layer_city.js";
import { colourOf } from "./palette.js";

/** From the outline of its cells, an outline lies so much inside: blocks that meet at a corner stay apart. */
const INSET = 0.07;
const TONES = 3;
/** How far roofs stand above the ground, in cells, and where their shadow lies. */
const HEIGHT = 0.16;
const SHADOW = 0.17;
/** Cells of fewer CSS pixels show neither their grid nor each of their trees. */
const FINE = 13;
const SMALLEST_SIGN = 12;

/** Shapes in cells, found once for each map: they are drawn in all sizes and colours. @type {WeakMap<object, object>} */
const shapes = new WeakMap();

/** @param {CanvasRenderingContext2D} ctx @param {number} [smallest] CSS pixels that a sign takes at least. */
export function drawBlocks(ctx, { world, layout, names }, smallest = SMALLEST_SIGN) {
  const { cell, left, top, scale } = layout;
  if (!shapes.has(world)) shapes.set(world, shapesOf(world, names));
  const found = shapes.get(world);
  const { buildings, trees, obstacles, hatching, signs } = found;
  const line = (pixels) => Math.max(scale * pixels, 1) / cell;
  const fine = cell >= FINE * scale;
  const place = (dx = 0, dy = 0) => ctx.setTransform(cell, 0, 0, cell, left + dx * cell, top + dy * cell);
  const paint = (path, colour) => {
    ctx.fillStyle = colourOf(colour);
    ctx.fill(path);
  };
  const outline = (path, colour, pixels = 1) => {
    ctx.lineWidth = line(pixels);
    ctx.strokeStyle = colourOf(colour);
    ctx.stroke(path);
  };
  ctx.lineJoin = "round";
  place();
  ctx.fillStyle = colourOf("--block-street");
  ctx.fillRect(0, 0, world.width, world.height);
  paint(obstacles, "--block-closed");
  ctx.save();
  ctx.clip(obstacles);
  outline(hatching, "--block-hatch");
  place(fine ? 0.5 : 0);
  outline(hatching, "--block-hatch");
  ctx.restore();
  outline(obstacles, "--block-hatch");
  paint(trees, "--block-wood");
  if (fine) paint((found.crowns ??= crownsOf(world, names)), "--block-crown");
  outline(trees, "--block-crown");
  place(SHADOW, SHADOW);
  for (const tone of buildings) paint(tone, "--map-shade");
  place();
  for (const tone of buildings) paint(tone, "--block-wall");
  place(0, -HEIGHT);
  buildings.forEach((tone, i) => paint(tone, `--block-roof-${i + 1}`));
  for (const tone of buildings) outline(tone, "--block-edge");
  ctx.setTransform(1, 0, 0, 1, 0, 0);
  ctx.globalAlpha = fine ? 0.35 : 0;
  drawGrid(ctx, world, layout);
  ctx.globalAlpha = 1;
  ctx.strokeRect(left - 0.5, top - 0.5, world.width * cell + 1, world.height * cell + 1);
  const side = Math.max(cell, smallest * scale);
  for (const [kind, x, y] of signs) drawFigure(ctx, kind, left + (x + 0.5) * cell, top + (y + 0.5) * cell, side);
  if (layout.labels) drawLabels(ctx, world, layout);
}

function shapesOf(world, names) {
  const { cells, width, height } = world;
  const tones = toneOfBlocks(world, names.indexOf("building"));
  const of = (kind, round) => joined(world, names.indexOf(kind), round, [new Path2D()])[0];
  const found = {
    buildings: joined(
      world,
      names.indexOf("building"),
      0.16,
      Array.from({ length: TONES }, () => new Path2D()),
      (cell) => tones[cell],
    ),
    trees: of("tree", 0.42),
    obstacles: of("obstacle", 0.2),
    hatching: new Path2D(),
    signs: [],
  };
  for (let at = -height; at < width; at++) {
    found.hatching.moveTo(at, 0);
    found.hatching.lineTo(at + height, height);
  }
  cells.forEach((row, y) => row.forEach((id, x) => names[id] === "pad" && found.signs.push(["pad", x, y])));
  return found;
}

function crownsOf({ cells }, names) {
  const path = new Path2D();
  cells.forEach((row, y) => row.forEach((id, x) => names[id] === "tree" && addCrowns(path, x, y)));
  return path;
}

/** Three trees in a cell, not two cells alike. */
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

/** Of each cell with a building the tone of its block: cells that share a side have one. */
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

/** The four ways along the sides of cells, each a turn to the right of the one before. */
const WAYS = [
  [1, 0],
  [0, 1],
  [-1, 0],
  [0, -1],
];
const TURNS = [1, 0, 3];

/**
 * Outlines of the shapes that cells make which share a side, with what they enclose on their right.
 *
 * @param {number} kind Of the cells. @param {number} round Radius of the corners. @param {Path2D[]} paths Get the outlines.
 * @param {(cell: number) => number} [which] Into which path that of a cell goes, whose number grows along the rows.
 */
function joined({ cells, width, height }, kind, round, paths, which = () => 0) {
  const corner = (x, y) => y * (width + 1) + x;
  /** By the corner where it begins, and way: the number of the cell on its right, from 1. An editor draws anew with every cell. */
  const sides = new Int32Array(4 * (width + 1) * (height + 1));
  const starts = [];
  const add = (x, y, way, cell) => {
    sides[corner(x, y) * 4 + way] = cell;
    starts.push(corner(x, y) * 4 + way);
  };
  for (let y = 0; y < height; y++) {
    const row = cells[y];
    for (let x = 0; x < width; x++) {
      if (row[x] !== kind) continue;
      const cell = y * width + x + 1;
      if (!y || cells[y - 1][x] !== kind) add(x, y, 0, cell);
      if (row[x + 1] !== kind) add(x + 1, y, 1, cell);
      if (y + 1 === height || cells[y + 1][x] !== kind) add(x + 1, y + 1, 2, cell);
      if (!x || row[x - 1] !== kind) add(x, y + 1, 3, cell);
    }
  }
  for (const start of starts) {
    if (!sides[start]) continue;
    const cell = sides[start] - 1;
    let way = start % 4;
    let x = Math.floor(start / 4) % (width + 1);
    let y = Math.floor(start / 4 / (width + 1));
    const corners = [];
    while (sides[corner(x, y) * 4 + way]) {
      sides[corner(x, y) * 4 + way] = 0;
      x += WAYS[way][0];
      y += WAYS[way][1];
      // Where two shapes meet at a corner, a turn to the right stays with the own one.
      const turn = TURNS.find((turn) => sides[corner(x, y) * 4 + ((way + turn) % 4)]);
      const to = turn === undefined ? start % 4 : (way + turn) % 4;
      if (to !== way) corners.push(within(x, y, way, to));
      way = to;
    }
    outlineOf(paths[which(cell)], corners, round);
  }
  return paths;
}

/** A corner of an outline, moved inside from the two sides that meet there. */
function within(x, y, way, next) {
  const moved = [x, y];
  for (const [dx, dy] of [WAYS[way], WAYS[next]]) {
    moved[0] -= dy * INSET;
    moved[1] += dx * INSET;
  }
  return moved;
}

function outlineOf(path, corners, round) {
  const last = corners.at(-1);
  path.moveTo((last[0] + corners[0][0]) / 2, (last[1] + corners[0][1]) / 2);
  for (let i = 0; i < corners.length; i++) {
    const [x, y] = corners[i];
    const [nextX, nextY] = corners[(i + 1) % corners.length];
    path.arcTo(x, y, nextX, nextY, round);
  }
  path.closePath();
}
