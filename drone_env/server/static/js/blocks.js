// Large maps and real cities: adjacent cells of one kind are drawn as one block.
import { colourOf } from "./base.js";
import { drawGrid, drawLabels, variety } from "./layer_city.js";

/** The offsets of roofs and shadows, in cells. */
const HEIGHT = 0.16;
const SHADOW = 0.17;
/** Smaller cells, in CSS pixels, show no grid and no single trees. */
const FINE = 13;

/** Paths in units of cells, cached per map. @type {WeakMap<object, object>} */
const shapes = new WeakMap();

export function drawBlocks(ctx, { world, layout, names }) {
  const { cell, left, top, scale } = layout;
  if (!shapes.has(world)) shapes.set(world, shapesOf(world, names));
  const { building, tree, crowns, obstacle, hatching } = shapes.get(world);
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
  outlined(obstacle, "--block-closed", "--block-hatch");
  ctx.save();
  ctx.clip(obstacle);
  ctx.lineWidth = Math.max(scale, 1) / cell;
  ctx.stroke(hatching);
  ctx.restore();
  outlined(tree, "--block-wood", "--block-crown");
  if (fine) paint(crowns, "--block-crown");
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
  ctx.globalAlpha = fine ? 0.35 : 0;
  drawGrid(ctx, world, layout);
  ctx.globalAlpha = 1;
  ctx.strokeRect(left - 0.5, top - 0.5, world.width * cell + 1, world.height * cell + 1);
  if (layout.labels) drawLabels(ctx, world, layout);
}

function shapesOf({ cells, width, height }, names) {
  const found = {};
  for (const name of ["building", "tree", "crowns", "obstacle", "hatching"]) found[name] = new Path2D();
  for (let at = -height; at < width; at += 0.5) {
    found.hatching.moveTo(at, 0);
    found.hatching.lineTo(at + height, height);
  }
  cells.forEach((row, y) =>
    row.forEach((id, x) => {
      found[names[id]]?.rect(x, y, 1, 1);
      if (names[id] === "tree") addCrowns(found.crowns, x, y);
    }),
  );
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
