// History: charts of the finished episodes of a task, and the table of all of them. A click on one replays it.
import { el } from "./dom.js";
import { EpisodeTable } from "./episode_table.js";
import { title } from "./format.js";
import { HistoryCharts } from "./history_charts.js";

const PAGE = 25;

/** @param {HTMLElement} root An empty section. @param {import("./context.js").Context} context */
export function mount(root, context) {
  const history = new History(root, context);
  let unsubscribe = null;
  context.on("view", (view) => {
    if (view === "history" && !unsubscribe) {
      unsubscribe = context.live.subscribe("episodes");
      history.load();
    } else if (view !== "history") {
      unsubscribe?.();
      unsubscribe = null;
    }
  });
  context.live.on("episodes", ({ episodes }) => {
    if (unsubscribe) history.heard(episodes);
  });
  context.live.on("state", ({ state }) => {
    if (unsubscribe && state === "open" && history.failed) history.load();
  });
}

class History {
  constructor(root, context) {
    this.context = context;
    /** Numbers before which the pages up to this one start; the first is that of the newest page. */
    this.pages = [null];
    this.next = null;
    this.asked = 0;
    this.failed = false;
    this.agents = new Set(context.pilots.map((pilot) => pilot.id));
    this.timer = 0;

    this.task = el(
      "select",
      { id: "history-task", on: { change: () => this.restart() } },
      el("option", { value: "", text: "All tasks" }),
      ...context.tasks.map((task) => el("option", { value: task.short_name, text: title(task.short_name) })),
    );
    this.agent = el("select", { id: "history-agent", on: { change: () => this.restart() } });
    this.charts = new HistoryCharts(el("div.charts"), context);
    this.table = new EpisodeTable(context);
    this.newer = el("button.button.small", { text: "Newer", press: () => this.back() });
    this.older = el("button.button.small", { text: "Older", press: () => this.forth() });
    this.note = el("p.note", { role: "status" });
    root.append(
      el(
        "div.view-head",
        el("h2", { text: "Episodes" }),
        el(
          "div.filters",
          el("label", { for: "history-task" }, el("span", { text: "Task" }), this.task),
          el("label", { for: "history-agent" }, el("span", { text: "Agent" }), this.agent),
        ),
      ),
      this.charts.root,
      this.table.root,
      el("div.pager", this.newer, this.older, this.note),
    );
    this.offerAgents();
  }

  /** From the newest page on, as after another choice. */
  restart() {
    this.pages = [null];
    return this.load();
  }

  back() {
    this.pages.pop();
    return this.load();
  }

  forth() {
    this.pages.push(this.next);
    return this.load();
  }

  async load() {
    const asked = ++this.asked;
    const task = this.task.value;
    const query = { task, agent: this.agent.value, limit: PAGE, before: this.pages.at(-1) };
    try {
      const answer = await this.context.api.get("episodes", query);
      if (asked !== this.asked) return;
      this.failed = false;
      this.next = answer.next;
      this.show(answer.episodes);
      await this.charts.load(task || this.someTask(answer.episodes));
    } catch (error) {
      if (asked !== this.asked) return;
      this.failed = true;
      this.note.textContent = `The history could not be loaded: ${error.message}`;
    }
  }

  /** What the charts show of all tasks: that of the newest episode. */
  someTask([newest]) {
    const { tasks } = this.context;
    return (tasks.find((task) => task.id === newest?.task) ?? tasks[0]).short_name;
  }

  show(episodes) {
    this.table.show(episodes);
    for (const episode of episodes) this.agents.add(episode.agent);
    this.offerAgents();
    this.newer.disabled = this.pages.length === 1;
    this.older.disabled = this.next === null;
    this.note.textContent = episodes.length
      ? `Page ${this.pages.length}`
      : "No episode yet. Fly one, and it stands here.";
  }

  offerAgents() {
    const chosen = this.agent.value;
    this.agent.replaceChildren(
      el("option", { value: "", text: "All agents" }),
      ...[...this.agents].map((agent) => el("option", { value: agent, text: agent })),
    );
    this.agent.value = chosen;
  }

  /** Episodes have finished, by whomever. Only the newest page changes by that; several at once are one change. */
  heard(episodes) {
    if (this.pages.length > 1 || episodes.every((episode) => this.table.has(episode.id))) return;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.load(), 300);
  }
}
