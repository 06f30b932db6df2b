// A table of finished episodes; each can be replayed.
import { el, table } from "./dom.js";
import { fixed, moment, outcome, points, title } from "./format.js";

const CAPTION = "Finished episodes, newest first. Scores, optima and regrets are times 100.";
/** Name of the column, what stands in it, whether it is a number. */
const COLUMNS = [
  ["Finished", (e) => el("time", { datetime: e.finished_at, text: moment(e.finished_at) })],
  ["Task", (e) => title(e.task)],
  ["Map", (e) => String(e.seed), true],
  ["Agent", (e) => e.agent],
  ["Outcome", (e) => outcome(e)],
  ["Parcels", (e) => `${e.deliveries} / ${e.deliveries_total}`, true],
  ["Steps", (e) => String(e.steps), true],
  ["Reward", (e) => fixed(e.reward_total), true],
  ["Score", (e) => points(e.score), true],
  ["Optimum", (e) => points(e.optimal_score), true],
  ["Regret", (e) => points(e.regret), true],
];

export class EpisodeTable {
  /** @param {import("./context.js").Context} context Told by "replay" which episode was clicked. */
  constructor(context) {
    this.context = context;
    this.ids = new Set();
    this.body = el("tbody");
    this.root = el(
      "div.scroller",
      { tabindex: "0", role: "region", "aria-label": "Table of episodes" },
      table(
        "table.table.episodes",
        {},
        CAPTION,
        [...COLUMNS.map(([name, , number]) => [name, number]), [""]],
        this.body,
      ),
    );
  }

  has(id) {
    return this.ids.has(id);
  }

  /** @param {object[]} episodes Summaries. */
  show(episodes) {
    this.ids = new Set(episodes.map((episode) => episode.id));
    this.body.replaceChildren(...episodes.map((episode) => this.row(episode)));
  }

  row(episode) {
    const replay = el("button.button.small", {
      text: "Replay",
      "aria-label": `Replay ${episode.task}, map ${episode.seed}, by ${episode.agent}`,
    });
    // The click on the button comes up to its row.
    return el(
      "tr",
      { data: { episode: episode.id }, press: () => this.context.emit("replay", episode.id) },
      ...COLUMNS.map(([, cell, number]) => el(number ? "td.num" : "td", cell(episode))),
      el("td", replay),
    );
  }
}
