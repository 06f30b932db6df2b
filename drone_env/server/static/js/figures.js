// The figures of the map, from the sheet that the Gymnasium renderer also uses, and the marks of the page.
import { colourOf } from "./base.js";
import { el } from "./dom.js";

/** The size of a figure on the sheet, in cells. */
const FIELD = 1.8;
const KEPT = 400;

/** The positions [x, y] of each kind on the sheet; a building has several. */
const places = new Map();
const drawn = new Map();
let sheet = null;
let side = 0;

/** Loads the sheet. Nothing can be drawn before. */
export async function loadFigures() {
  const answer = await fetch(new URL("../figures.svg", import.meta.url));
  const art = new DOMParser().parseFromString(await answer.text(), "image/svg+xml").documentElement;
  for (const figure of art.querySelectorAll("svg")) {
    const kind = figure.id.replace(/\d+$/, "");
    const [x, y, width] = ["x", "y", "width"].map((name) => Number(figure.getAttribute(name)));
    places.set(kind, [...(places.get(kind) ?? []), [x, y]]);
    side = width;
  }
  // The drone rotates, so its shadow is drawn separately.
  art.querySelector("#drone [filter]").remove();
  sheet = new Image();
  sheet.src = `data:image/svg+xml,${encodeURIComponent(new XMLSerializer().serializeToString(art))}`;
  await sheet.decode();
}

/** Draws a figure around its centre, in device pixels. @param {number} [variety] Selects one of several figures. */
export function drawFigure(ctx, kind, x, y, cell, variety = 0) {
  const there = places.get(kind);
  if (!there) return;
  const size = 2 * Math.round((cell * FIELD) / 2);
  ctx.drawImage(inSize(there[variety % there.length], size), Math.round(x) - size / 2, Math.round(y) - size / 2);
}

function inSize([x, y], size) {
  const key = `${x} ${y} ${size}`;
  if (!drawn.has(key)) {
    if (drawn.size === KEPT) drawn.clear();
    const canvas = el("canvas", { width: size, height: size });
    canvas.getContext("2d").drawImage(sheet, x, y, side, side, 0, 0, size, size);
    drawn.set(key, canvas);
  }
  return drawn.get(key);
}

/**
 * The drone from above, with rotors in the colour of its pilot.
 *
 * @param {number} size Its width in device pixels. @param {number} heading Radians, 0 is up.
 * @param {number} spin Angle of the rotors. @param {number} lift 0 on the ground, 1 in flight: the distance of the shadow.
 */
export function drawDrone(ctx, x, y, size, heading, spin, lift, colour) {
  ctx.save();
  ctx.translate(x, y);
  ctx.rotate(heading);
  ctx.shadowColor = colourOf("--map-shade");
  ctx.shadowOffsetX = ctx.shadowOffsetY = size * (0.06 + 0.12 * lift);
  drawFigure(ctx, "drone", 0, 0, size);
  ctx.shadowColor = "transparent";
  ctx.strokeStyle = colour;
  ctx.lineWidth = Math.max(1.2, size * 0.05);
  const rotor = size * 0.23;
  ctx.beginPath();
  for (let corner = 0; corner < 4; corner++) {
    const [sx, sy] = [corner % 2 ? 1 : -1, corner < 2 ? -1 : 1];
    const [cx, cy] = [sx * 0.3 * size, sy * 0.3 * size];
    const turn = spin * sx * sy;
    const [dx, dy] = [Math.cos(turn) * rotor * 0.8, Math.sin(turn) * rotor * 0.8];
    ctx.moveTo(cx + rotor, cy);
    ctx.arc(cx, cy, rotor, 0, 2 * Math.PI);
    ctx.moveTo(cx - dx, cy - dy);
    ctx.lineTo(cx + dx, cy + dy);
  }
  ctx.stroke();
  ctx.restore();
}

/** Brackets around the current target. */
export function drawTarget(ctx, x, y, cell, colour) {
  const side = cell * 0.94;
  const corner = cell * 0.2;
  ctx.strokeStyle = colour;
  ctx.lineWidth = Math.max(1.5, cell * 0.08);
  ctx.lineCap = "square";
  ctx.setLineDash([2 * corner, side - 2 * corner]);
  ctx.lineDashOffset = corner;
  ctx.strokeRect(x - side / 2, y - side / 2, side, side);
  ctx.setLineDash([]);
}

export function drawArrow(ctx, x1, y1, x2, y2, width) {
  const length = Math.hypot(x2 - x1, y2 - y1);
  if (length < 1) return;
  const neck = length - Math.min(length, width * 2.2);
  ctx.save();
  ctx.translate(x1, y1);
  ctx.rotate(Math.atan2(y2 - y1, x2 - x1));
  const [tail, shaft, head] = [0.35, 0.5, 1.25].map((share) => share * width);
  ctx.fill(new Path2D(`M0 ${-tail}L${neck} ${-shaft}V${-head}L${length} 0L${neck} ${head}V${shaft}L0 ${tail}z`));
  ctx.restore();
}
