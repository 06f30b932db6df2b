// What moves: trail, parcels, target, the network's values as arrows, ghost and drone. Drawn in every animation frame.
import { labelColour } from "./palette.js";
import { drawArrow, drawDrone, drawFigure, drawMark, drawTarget } from "./figures.js";

const STEP = { UP: [0, -1], DOWN: [0, 1], LEFT: [-1, 0], RIGHT: [1, 0] };
const DOT = { inaccuracy: 0.09, mistake: 0.13, blunder: 0.16 };
const RECENT = [9, 5, 2];
const SMALLEST_DRONE = 22;
const LARGE_DRONE = 56;

/**
 * @param {CanvasRenderingContext2D} ctx @param {import("./player.js").Player} player
 * @param {import("./map_terrain.js").Layout} layout
 * @param {{values: boolean, ghost: number[][]|null, spin: number, breath: number, lift: number}} shown
 */
export function drawFlight(ctx, player, layout, shown, colours) {
  const { mission, frames, position } = player;
  const { cell } = layout;
  const centre = ([x, y]) => [layout.left + (x + 0.5) * cell, layout.top + (y + 0.5) * cell];
  const frame = frames[Math.round(position)] ?? frames[0];
  const here = between(frames, position);
  const [x, y] = centre(here);
  const size = droneSize(cell, layout.scale);

  drawTrail(ctx, player, centre, here, cell, colours);
  if (shown.ghost) drawGhostPath(ctx, shown.ghost, centre, cell, layout, colours);
  const delivered = new Set(frame.delivered.map(String));
  for (const parcel of mission.parcels) {
    drawFigure(ctx, delivered.has(String(parcel)) ? "delivered" : "parcel", ...centre(parcel), cell);
  }
  if (frame.target) drawTarget(ctx, ...centre(frame.target), cell, shown.breath, colours);
  if (player.annotation) drawMistakes(ctx, player, centre, cell, layout);
  if (shown.ghost) {
    const ghost = shown.ghost[Math.min(Math.round(position), shown.ghost.length - 1)];
    ctx.globalAlpha = 0.5;
    if (ghost[0] !== frame.x || ghost[1] !== frame.y) drawFigure(ctx, "drone", ...centre(ghost), size);
    ctx.globalAlpha = 1;
  }
  const shownFrame = player.frame;
  if (shown.values && shownFrame?.q_values) drawValues(ctx, shownFrame.q_values, x, y, cell, size, colours);
  if (player.annotation) drawBetterMoves(ctx, player, x, y, cell, size, colours);
  drawDrone(ctx, x, y, size, heading(frames, position), shown.spin, shown.lift, colours);
  if (player.annotation) drawMarkHere(ctx, player, x, y, size, layout, colours);
}

/** A little larger than its cell, but neither lost on a small map nor a monster on a large one. */
function droneSize(cell, scale) {
  return Math.max(Math.min(cell * 1.2, Math.max(LARGE_DRONE * scale, cell * 0.8)), SMALLEST_DRONE * scale);
}

/** [x, y] at a position between two frames. */
function between(frames, position) {
  const k = Math.floor(position);
  const a = frames[k];
  const b = frames[k + 1] ?? a;
  const t = position - k;
  return [a.x + (b.x - a.x) * t, a.y + (b.y - a.y) * t];
}

/** Where the nose points: along the step that is flown, or the last one that moved. */
function heading(frames, position) {
  for (let k = Math.min(Math.ceil(position), frames.length - 1); k > 0; k--) {
    const dx = frames[k].x - frames[k - 1].x;
    const dy = frames[k].y - frames[k - 1].y;
    if (dx || dy) return Math.atan2(dx, -dy);
  }
  return 0;
}

function drawTrail(ctx, player, centre, here, cell, colours) {
  const { frames, position } = player;
  const end = Math.floor(position);
  ctx.strokeStyle = colours.accent;
  ctx.lineCap = ctx.lineJoin = "round";
  ctx.lineWidth = Math.max(1.5, cell * 0.09);
  ctx.globalAlpha = 0.42;
  ctx.beginPath();
  for (let k = 0; k <= end; k++) ctx.lineTo(...centre([frames[k].x, frames[k].y]));
  ctx.lineTo(...centre(here));
  ctx.stroke();
  // The last steps, the newest the strongest: strokes of several lengths over one another, without seams.
  ctx.lineWidth = Math.max(2, cell * 0.13);
  for (const steps of RECENT) {
    ctx.beginPath();
    for (let k = Math.max(0, end - steps); k <= end; k++) ctx.lineTo(...centre([frames[k].x, frames[k].y]));
    ctx.lineTo(...centre(here));
    ctx.stroke();
  }
  ctx.globalAlpha = 1;
}

function drawGhostPath(ctx, path, centre, cell, { scale }, colours) {
  const aside = cell * 0.13;
  ctx.strokeStyle = colours.map.ghost;
  ctx.lineWidth = Math.max(1.5 * scale, cell * 0.06);
  ctx.setLineDash([cell * 0.2, cell * 0.16]);
  ctx.lineCap = "butt";
  ctx.beginPath();
  for (const point of path) {
    const [x, y] = centre(point);
    ctx.lineTo(x + aside, y + aside);
  }
  ctx.stroke();
  ctx.setLineDash([]);
}

/** Arrows as long as an action is good beside the others; the best one stands out. Waiting is a ring. */
function drawValues(ctx, values, x, y, cell, size, colours) {
  const all = Object.values(values);
  const best = Math.max(...all);
  const spread = best - Math.min(...all) || 1;
  for (const [action, value] of Object.entries(values)) {
    const strength = (value - (best - spread)) / spread;
    ctx.fillStyle = ctx.strokeStyle = value === best ? colours.accent : colours.ink;
    ctx.globalAlpha = value === best ? 0.95 : 0.12 + 0.4 * strength;
    const width = Math.max(3, cell * 0.11);
    if (action === "WAIT") {
      if (value !== best) continue;
      ctx.lineWidth = width * 0.7;
      ctx.beginPath();
      ctx.arc(x, y, size * 0.68, 0, 2 * Math.PI);
      ctx.stroke();
      continue;
    }
    const [dx, dy] = STEP[action];
    const from = size * 0.56;
    const to = from + cell * (0.18 + 0.62 * strength);
    drawArrow(ctx, x + dx * from, y + dy * from, x + dx * to, y + dy * to, width);
  }
  ctx.globalAlpha = 1;
}

/** Small dots along the flight where something was given away. */
function drawMistakes(ctx, player, centre, cell, { scale }) {
  for (const move of player.annotation.moves) {
    const size = DOT[move.label];
    if (!size) continue;
    const frame = player.frames[move.step - 1];
    ctx.fillStyle = labelColour(move.label);
    ctx.beginPath();
    ctx.arc(...centre([frame.x, frame.y]), Math.max(2 * scale, cell * size), 0, 2 * Math.PI);
    ctx.fill();
  }
}

/** What would have been best from here, where something else was flown. */
function drawBetterMoves(ctx, player, x, y, cell, size, colours) {
  const next = player.annotation.moves[player.cursor];
  if (!next || next.label === "best" || player.position !== player.cursor) return;
  ctx.fillStyle = colours.map.ghost;
  for (const action of next.best_actions) {
    if (!STEP[action]) continue;
    const [dx, dy] = STEP[action];
    const from = size * 0.56;
    drawArrow(
      ctx,
      x + dx * from,
      y + dy * from,
      x + dx * (from + cell * 0.8),
      y + dy * (from + cell * 0.8),
      Math.max(3, cell * 0.13),
    );
  }
}

function drawMarkHere(ctx, player, x, y, size, { scale }, colours) {
  const move = player.annotation.moves[player.cursor - 1];
  if (!move?.mark || player.position !== player.cursor) return;
  drawMark(
    ctx,
    x + size * 0.46,
    y - size * 0.46,
    Math.max(18 * scale, size * 0.5),
    move.mark,
    labelColour(move.label),
    colours,
  );
}
