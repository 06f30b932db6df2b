// The flight as a strip: a bar per step as high as its reward, parcels as marks; a slider lies over it.
import { el } from "./dom.js";
import { cleared, fit } from "./fitted.js";
import { nextFrame } from "./loop.js";
import { labelColour, lanePalette } from "./palette.js";

/**
 * @param {HTMLElement} root @param {import("./context.js").Context} context
 * @param {{label: string, seek: (k: number) => void}} options `seek` is called when the slider is moved.
 * @returns {{show: (players: import("./player.js").Player[]) => void, refresh: () => void, canvas: HTMLCanvasElement}}
 */
export function mountTimeline(root, context, { label, seek }) {
  const canvas = el("canvas.timeline-strip", { "aria-hidden": "true" });
  const slider = el("input.timeline-slider", {
    type: "range",
    min: "0",
    max: "0",
    step: "1",
    value: "0",
    "aria-label": label,
  });
  slider.addEventListener("input", () => seek(Number(slider.value)));
  slider.addEventListener("pointermove", (event) => {
    slider.title = tip(Math.round((event.offsetX / slider.clientWidth) * Number(slider.max)));
  });
  root.classList.add("timeline");
  root.append(canvas, slider);
  let players = [];

  /** What happened in a step: that of the first flight that has it. */
  function tip(step) {
    const frame = players.find((player) => player.frames[step])?.frames[step];
    return frame ? `Step ${step}: ${frame.message}` : "";
  }

  function draw() {
    const ctx = cleared(canvas, size);
    if (!ctx || !players.length) return;
    const { width, height } = size;
    const lane = height / players.length;
    players.forEach((player, i) => drawLane(ctx, player, i, i * lane, width, lane - (players.length > 1 ? 2 : 0)));
  }

  function refresh() {
    const newest = Math.max(0, ...players.map((player) => player.frames.length - 1));
    const shown = Math.max(0, ...players.map((player) => player.cursor));
    if (slider.max !== String(newest)) slider.max = String(newest);
    slider.value = String(shown);
    slider.disabled = newest === 0;
    slider.setAttribute("aria-valuetext", `step ${shown} of ${newest} flown`);
    // The slider reaches as far as has been flown; the strip is as long as the flight may be.
    const most = Math.max(1, ...players.map((player) => player.mission?.max_steps ?? 1));
    slider.style.width = `${Math.max((newest / most) * 100, 0)}%`;
    nextFrame(draw);
  }

  const size = fit(root, [canvas], draw);
  context.on("theme", () => nextFrame(draw));
  return {
    canvas,
    refresh,
    show(shown) {
      players = shown.filter((player) => !player.empty);
      refresh();
    },
  };
}

function drawLane(ctx, player, index, top, width, height) {
  const { mission, frames, cursor } = player;
  const colours = lanePalette(index);
  const step = width / mission.max_steps;
  const bar = Math.max(1, step - (step > 4 ? 1 : 0.25));
  ctx.fillStyle = colours.panel;
  ctx.fillRect(0, top, width, height);
  const most = Math.max(...frames.map((frame) => Math.abs(frame.reward)), 1e-9);
  for (let k = 1; k < frames.length; k++) {
    const frame = frames[k];
    const x = (k - 1) * step;
    const move = player.annotation?.moves[k - 1];
    const high = Math.max(2, (Math.abs(frame.reward) / most) * (height - 4));
    ctx.globalAlpha = k > cursor ? 0.3 : 1;
    if (frame.event === "delivery") ctx.fillStyle = colours.map.box;
    else if (move && move.label !== "best" && move.label !== "good") ctx.fillStyle = labelColour(move.label);
    else ctx.fillStyle = colours.lineStrong;
    ctx.fillRect(x, top + height - high, bar, high);
  }
  ctx.globalAlpha = 1;
  ctx.fillStyle = colours.accent;
  ctx.fillRect(Math.min(cursor * step, width - 2), top, 2, height);
}
