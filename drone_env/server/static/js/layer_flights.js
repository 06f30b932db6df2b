// The moving parts: trails, parcels, target, network values, best flight and drones.
import { colourOf, labelColour } from "./base.js";
import { drawArrow, drawDrone, drawFigure, drawTarget } from "./figures.js";

export const STEP = { UP: [0, -1], DOWN: [0, 1], LEFT: [-1, 0], RIGHT: [1, 0] };
const DOT = { inaccuracy: 0.09, mistake: 0.13, blunder: 0.16 };
const SMALLEST_DRONE = 22;
const LARGE_DRONE = 56;
const SMALLEST_PARCEL = 18;
/** The minimum width of a line in CSS pixels. */
const THIN = 3;
/** The offset between flights in the same cell, in cells. */
const ASIDE = 0.09;

/** The middle of a cell in device pixels. @returns {[number, number]} @param {Layout} layout @param {number[]} cell */
export const middle = ({ left, top, cell }, [x, y]) => [left + (x + 0.5) * cell, top + (y + 0.5) * cell];

/** The size of a drone: about a cell, within limits. */
const droneSize = ({ cell, scale }) =>
  Math.max(Math.min(cell * 1.2, Math.max(LARGE_DRONE * scale, cell * 0.8)), SMALLEST_DRONE * scale);

/** All flights; the selected one is drawn last, above the others. */
const inOrder = ({ tracks, track }) => [...tracks.filter((other) => other !== track), track];

export function drawTrails(ctx, view) {
  const { layout, clock, track } = view;
  const { cell, scale } = layout;
  ctx.lineCap = ctx.lineJoin = "round";
  ctx.lineWidth = Math.max(THIN * scale, 0.1 * cell);
  ctx.globalAlpha = 0.55;
  inOrder(view).forEach((one, i) => {
    const aside = one === track ? 0 : (i + 1) * ASIDE * cell;
    const at = { ...layout, left: layout.left + aside, top: layout.top + aside };
    ctx.strokeStyle = colourOf(one.colour);
    ctx.beginPath();
    for (const { x, y } of one.frames.slice(0, clock.position + 1)) ctx.lineTo(...middle(at, [x, y]));
    ctx.lineTo(...middle(at, one.at(clock.position)));
    ctx.stroke();
  });
  ctx.globalAlpha = 1;
}

/** The best flight as a dashed line, beside the lines of the flights where they share cells. */
export function drawBest(ctx, { track, tracks, layout, clock }) {
  const path = track.annotation?.optimum?.path;
  if (!path) return;
  const { cell, scale } = layout;
  const width = Math.max(THIN * scale, cell * 0.06);
  const flown = new Set(tracks.flatMap(({ frames }) => frames.slice(0, clock.position + 1).map(({ x, y }) => `${x},${y}`)));
  ctx.strokeStyle = colourOf("--map-ghost");
  ctx.lineWidth = width;
  ctx.setLineDash([Math.max(cell * 0.2, 2 * width), Math.max(cell * 0.16, 1.5 * width)]);
  ctx.lineCap = "butt";
  ctx.beginPath();
  for (const point of path) {
    const [x, y] = middle(layout, point);
    const aside = flown.has(String(point)) ? Math.max(cell * 0.13, 1.5 * width) : 0;
    ctx.lineTo(x + aside, y + aside);
  }
  ctx.stroke();
  ctx.setLineDash([]);
  ctx.globalAlpha = 0.5;
  const here = path[Math.min(Math.round(clock.position), path.length - 1)];
  drawFigure(ctx, "drone", ...middle(layout, here), droneSize(layout));
  ctx.globalAlpha = 1;
}

/** The parcels and the target of the selected flight, and its moves that lost something. */
export function drawParcels(ctx, { world, track, layout, clock }) {
  const { cell, scale } = layout;
  const frame = track.frameAt(Math.round(clock.position));
  const side = Math.max(cell, SMALLEST_PARCEL * scale);
  const delivered = new Set(frame.delivered.map(String));
  for (const parcel of world.parcels) {
    drawFigure(ctx, delivered.has(String(parcel)) ? "delivered" : "parcel", ...middle(layout, parcel), side);
  }
  if (frame.target) drawTarget(ctx, ...middle(layout, frame.target), side, colourOf(track.colour));
  for (const move of track.annotation?.moves ?? []) {
    const size = DOT[move.label];
    if (!size) continue;
    ctx.fillStyle = labelColour(move.label);
    ctx.beginPath();
    ctx.arc(...middle(layout, track.at(move.step - 1)), Math.max(2 * scale, cell * size), 0, 2 * Math.PI);
    ctx.fill();
  }
}

/** The network's values as arrows: the longer, the better. The best one is highlighted; WAIT is a ring. */
export function drawThoughts(ctx, { track, layout, clock }) {
  const values = track.frameAt(clock.cursor).q_values;
  if (!values) return;
  const { cell, scale } = layout;
  const [x, y] = middle(layout, track.at(clock.position));
  const size = droneSize(layout);
  const all = Object.values(values);
  const best = Math.max(...all);
  const spread = best - Math.min(...all) || 1;
  for (const [action, value] of Object.entries(values)) {
    const strength = (value - (best - spread)) / spread;
    ctx.fillStyle = ctx.strokeStyle = colourOf(value === best ? "--network" : "--ink");
    ctx.globalAlpha = value === best ? 1 : 0.12 + 0.4 * strength;
    const width = Math.max(THIN * scale, cell * 0.11);
    if (action !== "WAIT") pointTo(ctx, action, x, y, size * 0.56, cell * (0.18 + 0.62 * strength), width);
    else if (value === best) {
      ctx.lineWidth = width * 0.7;
      ctx.beginPath();
      ctx.arc(x, y, size * 0.68, 0, 2 * Math.PI);
      ctx.stroke();
    }
  }
  ctx.globalAlpha = 1;
}

/** An arrow from beside a point in the direction of an action. */
export function pointTo(ctx, action, x, y, from, length, width) {
  const [dx, dy] = STEP[action];
  const to = from + length;
  drawArrow(ctx, x + dx * from, y + dy * from, x + dx * to, y + dy * to, width);
}

export function drawDrones(ctx, view) {
  const { track, layout, clock, spin } = view;
  const { cell } = layout;
  const size = droneSize(layout);
  inOrder(view).forEach((one, i) => {
    const [x, y] = middle(layout, one.at(clock.position));
    const lift = one.frameAt(Math.round(clock.position)).done ? 0.15 : 1;
    const front = one === track;
    const aside = front ? 0 : (i + 1) * ASIDE * cell;
    ctx.globalAlpha = front ? 1 : 0.75;
    const wide = front ? size : size * 0.8;
    drawDrone(ctx, x + aside, y + aside, wide, one.heading(clock.position), spin, lift, colourOf(one.colour));
  });
  ctx.globalAlpha = 1;
}
