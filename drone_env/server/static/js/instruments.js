// The instruments of the selected flight.
import { el, setText } from "./dom.js";
import { cellName, fixed, percent, signed } from "./format.js";

/** What counts in flight, beside the choices above the map: battery, parcels and steps. @param {HTMLElement} root @param {Context} context */
export function mountGauges(root, { stage }) {
  const battery = meter("Battery", "battery");
  const steps = meter("Steps", "steps");
  const parcels = gauge("Parcels", { id: "parcels" }, el("div.pips"));
  root.append(battery, parcels, steps);
  stage.on("change", () => {
    const { frame, world } = stage;
    if (!frame) return;
    fill(battery, frame.battery, `${frame.battery_units} of ${world.battery_capacity}`, percent(frame.battery));
    battery.dataset.low = String(frame.battery < 0.2);
    fill(steps, frame.step / world.max_steps, `${frame.step} of ${world.max_steps}`, `step ${frame.step}`);
    drawPips(parcels, frame.deliveries_done, world.parcels.length);
  });
}

/** Name, id and text of what a frame says beside the gauges and the points. @type {[string, string, (frame: any) => string][]} */
const NUMBERS = [
  ["Reward", "reward", ({ step, reward }) => (step ? signed(reward, 3) : "–")],
  ["Total", "reward-total", ({ reward_total }) => fixed(reward_total, 2)],
  ["Efficiency (not the score)", "efficiency", ({ efficiency }) => fixed(efficiency, 1)],
  ["Target", "target", ({ target, distance }) => (target ? `[${target.join(", ")}], distance ${distance}` : "–")],
  ["Cell below", "below", ({ cell_below }) => cellName(cell_below)],
];

/** @param {HTMLElement} root @param {Context} context */
export function mountInstruments(root, { stage }) {
  const values = NUMBERS.map(([, id]) => el("dd", { id }));
  const rows = NUMBERS.map(([name], i) => el("div", el("dt", { text: name }), values[i]));
  root.append(el("details", el("summary.note", { text: "More numbers" }), el("dl.numbers", ...rows)));
  stage.on("change", () => {
    const { frame, world } = stage;
    root.hidden = !frame;
    if (!frame) return;
    NUMBERS.forEach(([, , write], i) => setText(values[i], write(frame)));
    rows.at(-1).hidden = !world.task.pads;
  });
}

const gauge = (name, props, figure) =>
  el("div.gauge", props, el("span.gauge-name", { text: name }), figure, el("span.gauge-text"));

function meter(name, id) {
  const props = { id, role: "meter", "aria-label": name, "aria-valuemin": "0", "aria-valuemax": "1", "aria-valuenow": "0" };
  return gauge(name, props, el("div.gauge-bar", el("i")));
}

function fill(node, share, text, spoken) {
  node.style.setProperty("--share", String(share));
  node.setAttribute("aria-valuenow", share.toFixed(3));
  node.setAttribute("aria-valuetext", spoken);
  setText(node.lastElementChild, text);
}

function drawPips(node, done, total) {
  const pips = node.querySelector(".pips");
  while (pips.childElementCount < total) pips.append(el("i"));
  while (pips.childElementCount > total) pips.lastElementChild.remove();
  [...pips.children].forEach((pip, i) => pip.classList.toggle("done", i < done));
  setText(node.lastElementChild, `${done} of ${total}`);
}
