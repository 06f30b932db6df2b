// The graph of the possible score by step, one line per flight, under a slider.
import { colourOf, fit, font, labelColour, nextFrame } from "./base.js";
import { points } from "./format.js";
import { describe } from "./moves.js";

const MARKED = { inaccuracy: 2.5, mistake: 4, blunder: 5.5 };
const ROOM = { top: 15, bottom: 14, side: 2 };
/** The offset between overlapping lines, in pixels. */
const ASIDE = 1.5;
/** The minimum width of the graph in steps. */
const SHORTEST = 10;

/** @param {HTMLElement} root @param {Context} context */
export function mountTimeline(root, context) {
  const { stage } = context;
  const canvas = root.querySelector("canvas");
  const slider = root.querySelector("input");
  slider.addEventListener("input", () => stage.clock.goTo(Number(slider.value)));

  function draw() {
    const { width, height, scale } = size;
    const ctx = canvas.getContext("2d");
    ctx.setTransform(scale, 0, 0, scale, 0, 0);
    ctx.clearRect(0, 0, width, height);
    if (!stage.tracks.length) return;
    const { clock, track, tracks } = stage;
    const x = (step) => ROOM.side + (step / wide()) * (width - 2 * ROOM.side);
    const [low, high] = range(tracks);
    const y = (value) => ROOM.top + ((high - value) / (high - low)) * (height - ROOM.top - ROOM.bottom);
    drawEvents(ctx, track, x, height);
    tracks.forEach((one, i) => drawLine(ctx, one, x, y, (i - stage.selected) * ASIDE, one === track));
    drawMarks(ctx, track, x, y);
    ctx.fillStyle = colourOf("--ink");
    ctx.fillRect(x(clock.cursor) - 1, 0, 2, height);
    if (tracks.some(({ frames }) => frames.some(({ value }) => value !== null))) drawScale(ctx, y, [low, high], width);
  }

  /** The width of the graph in steps; a live flight has some free steps on the right. */
  const wide = () => Math.max(SHORTEST, stage.clock.end(), stage.over ? 0 : Math.min(stage.world.max_steps, stage.clock.end() + 5));

  function refresh() {
    if (!stage.world) return nextFrame(draw);
    const newest = stage.clock.end();
    slider.max = String(newest);
    slider.value = String(stage.clock.cursor);
    slider.disabled = newest === 0;
    slider.setAttribute("aria-valuetext", `Step ${stage.clock.cursor}: ${describe(stage.track, stage.clock.cursor)}`);
    slider.style.width = `${(newest / wide()) * 100}%`;
    nextFrame(draw);
  }

  const size = fit(root, canvas, draw);
  context.on("theme", () => nextFrame(draw));
  document.fonts.ready.then(() => nextFrame(draw));
  stage.on("change", refresh);
}

function range(tracks) {
  const all = tracks.flatMap(({ frames }) => frames.map(({ value, score }) => value ?? score));
  const high = Math.min(1, Math.ceil(Math.max(...all) * 10) / 10);
  return [Math.max(0, Math.min(high - 0.2, Math.floor(Math.min(...all) * 10) / 10)), high];
}

function drawScale(ctx, y, [low, high], width) {
  ctx.font = font(11, 400);
  ctx.fillStyle = colourOf("--ink-3");
  ctx.strokeStyle = colourOf("--line");
  ctx.lineWidth = 1;
  ctx.textAlign = "right";
  ctx.textBaseline = "bottom";
  for (const value of [low, high]) {
    const at = Math.round(y(value)) + 0.5;
    ctx.beginPath();
    ctx.moveTo(0, at);
    ctx.lineTo(width, at);
    ctx.stroke();
  }
  ctx.lineWidth = 4;
  ctx.strokeStyle = colourOf("--panel");
  const write = (text, at) => {
    ctx.strokeText(text, width - 4, at);
    ctx.fillText(text, width - 4, at);
  };
  write(points(low, 0), y(low) - 2);
  write(`${points(high, 0)} still possible`, y(high) - 2);
}

/** The deliveries and charges of the selected flight. */
function drawEvents(ctx, { frames }, x, height) {
  frames.forEach((frame, step) => {
    const before = frames[step - 1];
    if (frame.event === "delivery") {
      ctx.fillStyle = colourOf("--map-box");
      ctx.fillRect(x(step) - 3, height - 10, 6, 8);
    } else if (before && frame.battery_units > before.battery_units) {
      ctx.fillStyle = colourOf("--good");
      ctx.beginPath();
      ctx.arc(x(step), height - 6, 2.5, 0, 2 * Math.PI);
      ctx.fill();
    }
  });
}

/** The possible score, unless it is hidden. */
function drawLine(ctx, { frames, colour }, x, y, aside, front) {
  ctx.strokeStyle = colourOf(colour);
  ctx.globalAlpha = front ? 1 : 0.7;
  ctx.lineWidth = front ? 2.5 : 1.5;
  ctx.lineJoin = "round";
  ctx.beginPath();
  let before = null;
  frames.forEach(({ value }, step) => {
    if (value === null) return;
    // A move loses its points at once.
    if (before !== null) ctx.lineTo(x(step), y(before) + aside);
    ctx.lineTo(x(step), y(value) + aside);
    before = value;
  });
  ctx.stroke();
  ctx.globalAlpha = 1;
}

/** The moves of the selected flight that lost something; a larger dot is worse. */
function drawMarks(ctx, track, x, y) {
  for (const { step, label } of track.annotation?.moves ?? []) {
    const size = MARKED[label];
    const { value } = track.frames[step];
    if (!size || value === null) continue;
    ctx.fillStyle = labelColour(label);
    ctx.beginPath();
    ctx.arc(x(step), y(value), size, 0, 2 * Math.PI);
    ctx.fill();
  }
}
