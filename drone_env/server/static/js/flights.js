// The newest flights of a task, by all pilots or one.
import { el, keepFocus } from "./dom.js";
import { flightName, inWords, moment, outcome, points, shortened } from "./format.js";
import { grid, named } from "./rankings.js";

const PAGE = 50;

export class Flights {
  /** @param {Context} context */
  constructor(context) {
    this.context = context;
    this.task = null;
    /** The pages up to this one: each starts before a flight number, the first with the newest flight. */
    this.pages = [null];
    this.next = null;
    this.request = 0;
    this.agent = el("select", { id: "compare-agent", on: { change: () => this.turn(() => (this.pages = [null])) } });
    this.newer = el("button.button.small", { text: "Newer", press: () => this.turn(() => this.pages.pop()) });
    const older = () => this.pages.push(this.next);
    this.older = el("button.button.small", { text: "Older", press: () => this.turn(older) });
    this.note = el("p.note", { role: "status" });
    this.list = el("div.flight-list");
    const choice = el("label", { for: "compare-agent" }, el("span", { text: "Pilot" }), this.agent);
    this.root = el(
      "section.compare-part",
      el("div.view-head", el("h2", { text: "Newest flights" }), el("div.filters", choice)),
      this.list,
      el("div.pager", this.newer, this.older, this.note),
    );
  }

  /** Offers the pilots of a leaderboard. @param {Answer<"LeaderboardRow">[]} rows */
  offer(rows) {
    const chosen = this.agent.value;
    const known = rows.map(({ agent, by }) => el("option", { value: agent, text: shortened(inWords(this.context, by)) }));
    this.agent.replaceChildren(el("option", { value: "", text: "All" }), ...known);
    this.agent.value = chosen;
  }

  turn(page) {
    page();
    return this.load().catch((error) => (this.note.textContent = `The flights could not be loaded: ${error.message}`));
  }

  /** @param {Answer<"TaskInfo">} task Another one starts with the newest flights of all pilots. */
  async load(task = this.task) {
    if (this.task !== task) [this.task, this.pages, this.agent.value] = [task, [null], ""];
    const request = ++this.request;
    const query = { task: task.short_name, agent: this.agent.value, limit: PAGE, before: this.pages.at(-1) };
    const { episodes, next } = await this.context.api.get("episodes", query);
    if (request !== this.request) return;
    this.next = next;
    this.newer.disabled = this.pages.length === 1;
    this.older.disabled = next === null;
    this.note.textContent = episodes.length ? `Page ${this.pages.length}` : "No flights yet.";
    this.draw(episodes);
  }

  draw(episodes) {
    const drawn = JSON.stringify(episodes);
    if (this.drawn === drawn) return;
    this.drawn = drawn;
    const open = (e) =>
      el("a.button.small", {
        text: "Open",
        data: { key: e.id, episode: e.id },
        "aria-label": `Open ${flightName(this.context, e)}`,
        href: `?episode=${e.id}`,
      });
    const columns = [
      ["Pilot", (e) => named(this.context, { pilot: e.pilot, name: inWords(this.context, e) })],
      ["Map", (e) => String(e.seed), true],
      ["Score", (e) => points(e.score), true],
      ["Lost", (e) => points(e.regret), true],
      ["Outcome", outcome],
      ["Parcels", (e) => `${e.deliveries} / ${e.deliveries_total}`, true],
      ["Steps", (e) => String(e.steps), true],
      ["Finished", (e) => el("time", { datetime: e.finished_at, text: moment(e.finished_at) })],
      ["", open],
    ];
    keepFocus(this.list, () => this.list.replaceChildren(grid("Flights, newest first", columns, episodes)));
    this.list.hidden = !episodes.length;
  }
}
