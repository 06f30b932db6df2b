// The instruments of the selected flight: gauges, the bar of 100 points and further numbers.
import { el, setText } from "./dom.js";
import { cellName, fixed, optimumOf, percent, pointsBetween, signed } from "./format.js";

/** What counts in flight, beside the choices above the map. @param {HTMLElement} root @param {Context} context */
export function mountGauges(root, { stage }) {
  const [battery, parcels, steps] = root.querySelectorAll(".gauge");
  const pips = root.querySelector(".pips");
  stage.on("change", () => {
    const { frame, world } = stage;
    if (!frame) return;
    const { battery: share, battery_units: units, deliveries_done: done } = frame;
    battery.style.setProperty("--share", String(share));
    battery.setAttribute("aria-valuenow", share.toFixed(3));
    battery.setAttribute("aria-valuetext", percent(share));
    battery.dataset.low = String(share < 0.2);
    setText(battery.lastElementChild, `${units} of ${world.battery_capacity}`);
    setText(steps.lastElementChild, `${frame.step} of ${world.max_steps}`);
    setText(parcels.lastElementChild, `${done} of ${world.parcels.length}`);
    pips.replaceChildren(...world.parcels.map((_, i) => el(i < done ? "i.done" : "i")));
  });
}

/** What a frame says beside the gauges and the points, by id. @type {Record<string, (frame: any) => string>} */
const NUMBERS = {
  reward: ({ step, reward }) => (step ? signed(reward, 3) : "–"),
  "reward-total": ({ reward_total }) => fixed(reward_total, 2),
  efficiency: ({ efficiency }) => fixed(efficiency, 1),
  target: ({ target, distance }) => (target ? `[${target.join(", ")}], distance ${distance}` : "–"),
  below: ({ cell_below }) => cellName(cell_below),
};

/** @param {HTMLElement} root @param {Context} context */
export function mountInstruments(root, { stage }) {
  stage.on("change", () => {
    const { frame } = stage;
    root.hidden = !frame;
    if (frame) for (const [id, write] of Object.entries(NUMBERS)) setText(root.querySelector(`#${id}`), write(frame));
  });
}

/** Draws a bar of 100 points, and its legend. @param {HTMLElement} root @param {[kind: string, points: number, words: string][]} parts */
export function drawPoints(root, parts) {
  const shown = parts.filter(([kind, value]) => value > 0.01 || kind === "won");
  const bar = shown.map(([kind, value]) => el("i", { data: { kind }, style: { "--points": String(value) } }));
  const legend = shown.map(([kind, value, words]) => el("span", { data: { kind } }, el("strong", fixed(value, 1)), ` ${words}`));
  root.replaceChildren(el("div.points", { "aria-hidden": "true" }, ...bar), el("p.points-legend", ...legend));
}

/** What is won, still possible and lost at the present step. @param {HTMLElement} root @param {Context} context */
export function mountLivePoints(root, { stage }) {
  stage.on("change", () => {
    const { frame, track } = stage;
    root.hidden = !frame;
    if (!frame) return;
    const { done, score, value, deliveries_done: delivered, efficiency_parts: parts } = frame;
    const reached = done ? score : delivered ? parts[0].score : 0;
    const reachable = done ? score : (value ?? 1);
    const [won, possible, lost] = pointsBetween(0, reached, reachable, optimumOf(track) ?? reachable);
    const rest = value === null ? ["open", possible, "open"] : ["possible", possible, "still possible"];
    drawPoints(root, [["won", won, "won"], /** @type {[string, number, string]} */ (rest), ["lost", lost, "lost"]]);
  });
}
