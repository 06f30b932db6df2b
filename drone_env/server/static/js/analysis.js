// The analysis of all finished flights of a task, as the results show it.
import { ApiError } from "./api.js";
import { el } from "./dom.js";
import { fixed, percent, points, signed, title } from "./format.js";

/** Fills `root` with what all finished flights of the mission's task come to. @param {HTMLElement} root */
export async function analyse({ api }, mission, root) {
  try {
    const a = await api.get(`analyse/${encodeURIComponent(mission.task)}`);
    root.replaceChildren(
      el("h3", { text: `${howMany(a.episodes)} of ${title(mission.short_name)} here` }),
      el(
        "dl.numbers",
        ...[
          ["Success rate", percent(a.success_rate)],
          ["Success trend", a.success_trend === null ? "–" : `${signed(a.success_trend * 100, 0)} %`],
          ["Mean score", points(a.average_score)],
          ["Mean reward", fixed(a.average_reward, 2)],
          ["Mean steps", fixed(a.average_steps, 1)],
          ["Mean given away", points(a.mean_regret)],
        ].map(([name, text]) => el("div", el("dt", { text: name }), el("dd", { text }))),
      ),
      actionBar(a.action_distribution),
    );
  } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    root.replaceChildren(el("p.note", { text: `The analysis is not to be had: ${error.message}` }));
  }
  root.removeAttribute("aria-busy");
}

const howMany = (flights) => (flights === 1 ? "The only flight" : `All ${flights} flights`);

function actionBar(distribution) {
  const parts = Object.entries(distribution);
  return el(
    "div.actions-bar",
    ...parts.map(([action, share]) =>
      el(
        "div.action-part",
        { style: { "--share": String(share) } },
        el("i", { "aria-hidden": "true" }),
        el("span", { text: `${action} ` }),
        el("span", { text: percent(share) }),
      ),
    ),
  );
}
