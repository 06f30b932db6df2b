// Real places: the names of streets and districts, the scale, and north.
import { colourOf, font } from "./base.js";

/** The lengths of scales in metres. */
const METRES = [10, 20, 50, 100, 200, 500, 1000];
/** The maximum length of a scale in CSS pixels. */
const LONGEST = 110;

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
