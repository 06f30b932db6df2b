// The instruments of the selected flight.
import { el, setText } from "./dom.js";
import { cellName, fixed, isLost, percent, points, signed } from "./format.js";

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

/** @param {HTMLElement} root @param {Context} context */
export function mountInstruments(root, context) {
  const { stage } = context;
  const name = el("span.eyebrow");
  const score = el("strong.hero-number", { id: "score" });
  const optimum = el("span.hero-of", { id: "optimum" });
  const lost = row("Lost", "lost", "Optimum of this map minus the score still possible");
  const head = el(
    "div.score",
    el("div.score-main", name, el("p.hero", score, " ", optimum)),
    el("dl.score-side", ...lost.nodes),
  );
  const reward = row("Reward", "reward");
  const total = row("Total", "reward-total", "Sum of the rewards");
  const efficiency = row("Efficiency (not the score)", "efficiency");
  const target = row("Target", "target");
  const below = row("Cell below", "below");
  const numbers = [reward, total, efficiency, target, below].map(({ nodes }) => el("div", ...nodes));
  root.append(head, el("details", el("summary.note", { text: "More numbers" }), el("dl.numbers", ...numbers)));

  function draw() {
    const { frame, track, world } = stage;
    root.hidden = !frame;
    if (!frame) return;
    // Without values, the score of a flight that goes on would mislead.
    head.hidden = track.secret;
    setText(name, frame.done ? "Score" : "Still possible");
    setText(score, points(frame.done ? frame.score : frame.value));
    const best = track.annotation?.optimal_score ?? track.frames[0].value;
    setText(optimum, best === null ? "" : `of ${points(best)}${frame.done ? " possible" : ""}`);
    setText(lost.value, points(frame.regret));
    lost.value.dataset.some = String(isLost(frame.regret));
    setText(reward.value, frame.step ? signed(frame.reward, 3) : "–");
    setText(total.value, fixed(frame.reward_total, 2));
    setText(efficiency.value, fixed(frame.efficiency, 1));
    setText(target.value, frame.target ? `[${frame.target.join(", ")}], distance ${frame.distance}` : "–");
    setText(below.value, cellName(frame.cell_below));
    below.value.parentElement.hidden = !world.task.pads;
  }

  stage.on("change", draw);
}

function row(name, id, hint = null) {
  const value = el("dd", { id, text: "–" });
  return { value, nodes: [el("dt", { text: name, title: hint }), value] };
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
