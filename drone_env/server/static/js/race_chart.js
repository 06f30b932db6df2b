// Race: what each pilot has given away so far, step by step, while it happens.
import { el } from "./dom.js";
import { cleared, fit } from "./fitted.js";
import { nextFrame } from "./loop.js";
import { palette } from "./palette.js";

const TICKS = [0, 1, 5, 20, 50, 100];
const LINE = 14;
const ROOM = { left: 28, right: 8, top: 8, bottom: 20 };

/**
 * @param {HTMLElement} root @param {import("./context.js").Context} context @param {import("./fleet.js").Fleet} fleet
 * @returns {HTMLCanvasElement}
 */
export function mountRaceChart(root, context, fleet) {
  const canvas = el("canvas", {
    role: "img",
    "aria-label": "What each pilot has given away, by step. The standings have the numbers.",
  });
  const field = el("div.race-chart-field", canvas);
  root.append(el("figcaption", { text: "Given away of the score, by step" }), field);

  function draw() {
    const players = fleet.active;
    const ctx = cleared(canvas, size);
    if (!ctx || !players.length) return;
    const { width, height } = size;
    const colours = palette();
    const flown = Math.max(10, ...players.map((player) => player.frames.length - 1));
    const lost = Math.max(...players.map((player) => (player.last.regret ?? 0) * 100));
    const top = TICKS.find((tick) => tick >= Math.max(lost, 1)) ?? 100;
    // Roots, so that a lost half point can be seen beside fifty.
    const x = (step) => ROOM.left + (step / flown) * (width - ROOM.left - ROOM.right);
    const y = (points) => ROOM.top + Math.sqrt(points / top) * (height - ROOM.top - ROOM.bottom);
    drawAxes(ctx, x, y, top, flown, width, height, colours);
    players.forEach((player, i) => drawLine(ctx, player, x, y, colours[`lane${i + 1}`], i));
  }

  const redraw = () => nextFrame(draw);
  const size = fit(field, [canvas], draw);
  context.on("theme", redraw);
  context.on("missions", redraw);
  document.fonts.ready.then(redraw);
  for (const player of context.players) player.on("frames", redraw);
  return canvas;
}

function drawAxes(ctx, x, y, top, flown, width, height, colours) {
  ctx.font = `11px ${colours.font}`;
  ctx.fillStyle = colours.ink3;
  ctx.strokeStyle = colours.line;
  ctx.lineWidth = 1;
  ctx.textAlign = "right";
  ctx.textBaseline = "middle";
  let before = -LINE;
  for (const tick of TICKS.filter((t) => t <= top)) {
    const at = Math.round(y(tick)) + 0.5;
    if (at - before < LINE) continue;
    before = at;
    ctx.beginPath();
    ctx.moveTo(ROOM.left, at);
    ctx.lineTo(width - ROOM.right, at);
    ctx.stroke();
    ctx.fillText(tick ? `−${tick}` : "0", ROOM.left - 6, at);
  }
  ctx.textBaseline = "alphabetic";
  ctx.textAlign = "left";
  ctx.fillText("step 0", ROOM.left, height - 4);
  ctx.textAlign = "right";
  ctx.fillText(String(flown), width - ROOM.right, height - 4);
}

function drawLine(ctx, { frames }, x, y, colour, lane) {
  ctx.strokeStyle = ctx.fillStyle = colour;
  ctx.lineWidth = 2;
  ctx.lineJoin = "round";
  ctx.beginPath();
  // Lines that lie on one another stay visible side by side.
  const aside = lane * 1.5;
  let last = null;
  for (const frame of frames) {
    if (frame.regret === null) continue;
    last = [x(frame.step), y(frame.regret * 100) + aside];
    ctx.lineTo(...last);
  }
  ctx.stroke();
  if (!last) return;
  ctx.beginPath();
  ctx.arc(...last, 3.5, 0, 2 * Math.PI);
  ctx.fill();
}
