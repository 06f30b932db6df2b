// The charts above the history: reward, success, actions, regret.
import { Chart } from "./charts.js";
import { el } from "./dom.js";
import { fixed, percent, points, signed, title } from "./format.js";

const LAST = 200;

export class HistoryCharts {
  /**
   * @param {HTMLElement} root An empty element.
   * @param {import("./context.js").Context} context
   */
  constructor(root, context) {
    this.context = context;
    this.episodes = [];
    this.asked = 0;
    this.heading = el("h2");
    this.root = el("section.history-charts", { "aria-label": "Charts" }, this.heading, root);
    const pick = (i) => context.emit("replay", this.episodes[i].id);
    const chart = (options) => new Chart(root, context, { x: "Episode", ...options });
    this.reward = chart({
      title: "Reward",
      file: "reward",
      kind: "points",
      y: "Reward",
      format: (v) => fixed(v),
      pick,
    });
    this.success = chart({
      title: "Success, last 20 episodes",
      file: "success",
      kind: "line",
      y: "Success",
      format: (v) => percent(v),
      range: [0, 1],
      pick,
    });
    this.actions = chart({
      title: "Actions",
      file: "actions",
      kind: "bars",
      x: "Action",
      y: "Share",
      format: (v) => percent(v),
    });
    this.regret = chart({
      title: "Regret",
      file: "regret",
      kind: "points",
      y: "Regret",
      format: (v) => points(v),
      least: 0.01,
      pick,
    });
  }

  /** @param {string} task Short name. */
  async load(task) {
    const asked = ++this.asked;
    const { api } = this.context;
    const [history, analysis] = await Promise.all([
      api.get(`history/${task}`, { last: LAST }),
      api.get(`analyse/${task}`),
    ]);
    if (asked !== this.asked) return;
    const { episodes, rolling_success: success } = history;
    this.episodes = episodes;
    this.heading.textContent = `${title(task)}: ${count(analysis.episodes_total)}`;
    this.root.classList.toggle("empty", episodes.length === 0);
    const shares = Object.entries(analysis.action_distribution);
    await Promise.all([
      this.reward.show(
        episodes.map((e) => e.reward_total),
        `${fixed(analysis.average_reward)} on average over ${count(analysis.episodes)}.`,
      ),
      this.success.show(success, `${percent(analysis.success_rate)} delivered everything${trend(analysis)}.`),
      this.actions.show(
        episodes.length ? shares.map(([, share]) => share) : [],
        shares.map(([action, share]) => `${action} ${percent(share)}`).join(", "),
        shares.map(([action]) => action),
      ),
      this.regret.show(
        episodes.map((e) => e.regret),
        `${points(analysis.mean_regret)} points below the optimum on average, where it is known (${count(analysis.regret_episodes)}).`,
      ),
    ]);
  }
}

const count = (n) => `${n} ${n === 1 ? "episode" : "episodes"}`;

function trend(analysis) {
  if (analysis.success_trend === null) return "";
  return `; the newer half is at ${signed(analysis.success_trend * 100, 0)} points to the older`;
}
