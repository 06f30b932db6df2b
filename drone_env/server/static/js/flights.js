// The newest flights over a task, by all or by one.
import { el } from "./dom.js";
import { fixed, flightName, moment, outcome, points, who } from "./format.js";
import { grid } from "./rankings.js";

const PAGE = 50;

export class Flights {
  /** @param {import("./context.js").Context} context */
  constructor(context) {
    this.context = context;
    this.task = null;
    /** Numbers before which the pages up to this one start; the first is that of the newest page. */
    this.pages = [null];
    this.next = null;
    this.seed = null;
    this.asked = 0;
    this.agent = el("select", { id: "compare-agent", on: { change: () => this.filter(this.agent.value, null) } });
    this.map = el("button.button.small", { hidden: true, press: () => this.filter(this.agent.value, null) });
    this.newer = el("button.button.small", { text: "Newer", press: () => this.turn(() => this.pages.pop()) });
    const older = () => this.pages.push(this.next);
    this.older = el("button.button.small", { text: "Older", press: () => this.turn(older) });
    this.note = el("p.note", { role: "status" });
    this.list = el("div.flight-list");
    this.heading = el("h2", { text: "Newest flights", tabindex: "-1" });
    const choice = el("label", { for: "compare-agent" }, el("span", { text: "Pilot" }), this.agent);
    this.root = el(
      "section.compare-part",
      el("div.view-head", this.heading, el("div.filters", choice, this.map)),
      this.list,
      el("div.pager", this.newer, this.older, this.note),
    );
  }

  open({ id }) {
    this.context.router.go({ view: "fly", episode: id });
  }

  /** The newest of a task. @param {Object} task @param {Object[]} rows Of its leaderboard: who can be chosen. */
  show(task, rows) {
    if (this.task !== task) [this.task, this.pages, this.seed, this.agent.value] = [task, [null], null, ""];
    const chosen = this.agent.value;
    const known = rows.map(({ agent, name }) => el("option", { value: agent, text: name }));
    this.agent.replaceChildren(el("option", { value: "", text: "All" }), ...known);
    this.agent.value = chosen;
    return this.load();
  }

  /** Those of one pilot, over one map. @param {string} agent "" for all. @param {number|null} seed Null for all. */
  filter(agent, seed) {
    this.agent.value = agent;
    this.seed = seed;
    if (seed !== null) this.heading.focus();
    return this.turn(() => (this.pages = [null]));
  }

  turn(page) {
    page();
    return this.load().catch((error) => (this.note.textContent = `The flights could not be loaded: ${error.message}`));
  }

  async load() {
    const asked = ++this.asked;
    const [task, agent, seed] = [this.task.short_name, this.agent.value, this.seed];
    const query = { task, agent, seed, limit: PAGE, before: this.pages.at(-1) };
    const { episodes, next } = await this.context.api.get("episodes", query);
    if (asked !== this.asked) return;
    this.next = next;
    this.map.hidden = seed === null;
    this.map.textContent = `Map ${seed} ×`;
    this.map.setAttribute("aria-label", `All maps, not only map ${seed}`);
    this.newer.disabled = this.pages.length === 1;
    this.older.disabled = next === null;
    const none = "No flight yet. Fly one, and it stands here.";
    this.note.textContent = episodes.length ? `Page ${this.pages.length}` : none;
    this.draw(episodes);
  }

  draw(episodes) {
    const drawn = JSON.stringify(episodes);
    if (this.drawn === drawn) return;
    this.drawn = drawn;
    const open = (e) =>
      el("button.button.small", {
        text: "Open",
        data: { key: e.id, episode: e.id },
        "aria-label": `Open ${flightName(this.context, e)}`,
        press: () => this.open(e),
      });
    const columns = [
      ["Pilot", (e) => who(this.context, e.agent)],
      ["Map", (e) => String(e.seed), true],
      ["Score", (e) => points(e.score), true],
      ["Lost", (e) => points(e.regret), true],
      ["Outcome", (e) => outcome(e)],
      ["Parcels", (e) => `${e.deliveries} / ${e.deliveries_total}`, true],
      ["Steps", (e) => String(e.steps), true],
      ["Reward", (e) => fixed(e.reward_total), true],
      ["Finished", (e) => el("time", { datetime: e.finished_at, text: moment(e.finished_at) })],
      ["", open],
    ];
    const { key } = document.activeElement.dataset;
    this.list.replaceChildren(grid("Flights, newest first", columns, episodes));
    this.list.hidden = !episodes.length;
    if (key) this.list.querySelector(`[data-key="${CSS.escape(key)}"]`)?.focus();
  }
}
