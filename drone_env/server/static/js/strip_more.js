// What the strip unfolds: the efficiency of the flight in its parts, and what all finished flights of the task come to.
import { el, fact } from "./dom.js";
import { fixed, percent, points, signed, title } from "./format.js";

/** @param {HTMLElement} body Filled. @param {import("./context.js").Context} context */
export async function unfold(body, { api, stage }) {
  const { track, world } = stage;
  const analysis = el("div.analysis", { "aria-busy": "true" }, el("p.note", { text: "Counting …" }));
  body.replaceChildren(efficiencyBar(track.last), analysis);
  analysis.replaceChildren(...counted(await api.get(`analyse/${encodeURIComponent(world.task.id)}`), world));
  analysis.removeAttribute("aria-busy");
}

/** Three parts as wide as their weights, each filled by what is left or done. */
function efficiencyBar({ efficiency, efficiency_parts: parts }) {
  return el(
    "div.efficiency",
    { "aria-label": "Efficiency", role: "group" },
    el("p", { id: "efficiency-sum", text: `Efficiency ${fixed(efficiency, 1)} of 100` }),
    ...parts.map(({ name, weight, share }) =>
      el(
        "div.efficiency-part",
        { style: { "--weight": String(weight), "--share": String(share) } },
        el("div.efficiency-bar", { "aria-hidden": "true" }, el("i")),
        el("span.efficiency-name", { text: title(name) }),
        el("span.efficiency-share", { text: `${percent(share)} · weighs ${weight} %` }),
      ),
    ),
  );
}

/** What all finished flights of the task come to. */
function counted(figures, { task }) {
  const many = figures.episodes === 1 ? "The only flight" : `All ${figures.episodes} flights`;
  const rows = [
    ["Mean score", points(figures.average_score)],
    ["Mean lost", points(figures.mean_regret)],
    ["Success rate", percent(figures.success_rate)],
    ["Success trend", figures.success_trend === null ? "–" : `${signed(figures.success_trend * 100, 0)} points`],
    ["Mean steps", fixed(figures.average_steps, 1)],
    ["Mean reward", fixed(figures.average_reward)],
  ];
  const shares = Object.entries(figures.action_distribution).map(([action, share]) => `${action} ${percent(share)}`);
  return [
    el("h3", { text: `${many} of ${title(task.short_name)} here` }),
    el("dl.numbers", ...rows.map(([name, text]) => fact(name, text))),
    el("p.note", { text: shares.join(" · ") }),
  ];
}
