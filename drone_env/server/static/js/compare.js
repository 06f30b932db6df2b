// Compare: leaderboard, pairs, runs over the same maps, training curves and newest flights.
import { el, keepFocus } from "./dom.js";
import { Flights } from "./flights.js";
import { title, who } from "./format.js";
import { leaderboard, mapsOf, paired, runsOf, unflown } from "./rankings.js";
import { mountTraining } from "./training.js";

const TOPICS = ["episodes", "training"];
/** Milliseconds between the end of a flight and the reload, which may cover several flights. */
const PAUSE = 300;
const MOST = 2;

/** @param {HTMLElement} root @param {Context} context */
export function mount(root, context) {
  const { live, router } = context;
  const compare = new Compare(root, context);
  const train = mountTraining(root);
  let shown = false;
  const look = () => {
    const before = shown;
    shown = router.address.view === "compare";
    if (shown && before) compare.look();
    else if (shown) {
      live.subscribe(TOPICS);
      compare.load();
    }
  };
  router.on("address", look);
  live.on("training", ({ curve }) => shown && train(curve));
  live.on("episodes", ({ episodes }) => shown && compare.onEpisodes(episodes));
  live.on("state", ({ state }) => shown && state === "open" && compare.failed && compare.load());
  look();
}

class Compare {
  constructor(root, context) {
    this.context = context;
    this.request = 0;
    this.timer = 0;
    this.failed = false;
    this.task = this.board = this.runs = null;
    const option = (task) => el("option", { value: task.short_name, text: title(task.short_name) });
    const group = ([family, tasks]) => el("optgroup", { label: title(family) }, ...tasks.map(option));
    this.choice = el(
      "select",
      { id: "compare-task", on: { change: () => this.go([], this.choice.value) } },
      ...[...context.families].map(group),
    );
    context.on("task", (task) => this.choice.append(option(task)));
    this.problem = el("p.problem", { role: "alert", hidden: true });
    this.rows = el("div");
    this.chosen = el("section.compare-part", { hidden: true });
    this.ranked = el("section.compare-part", { hidden: true });
    this.flights = new Flights(context);
    root.append(
      el(
        "div.view-head",
        el("h2", { text: "Leaderboard" }),
        el("div.filters", el("label", { for: "compare-task" }, el("span", { text: "Task" }), this.choice)),
      ),
      this.problem,
      this.rows,
      this.chosen,
      this.ranked,
      this.flights.root,
    );
  }

  /** The pilots of the address: one shows its maps, two are compared. */
  get pilots() {
    return this.context.router.address.pilots.slice(0, MOST);
  }

  /** Those of them that have not flown the task. */
  get missing() {
    return this.pilots.filter((pilot) => !this.board.rows.some(({ agent }) => agent === pilot));
  }

  go(pilots, task = this.task.short_name) {
    this.context.router.go({ view: "compare", task, pilots });
  }

  look() {
    const { task } = this.context.router.address;
    if (this.task && (task === null || this.context.task(task) === this.task)) this.choose(this.request);
    else if (task !== this.wanted) this.load();
  }

  async load() {
    const request = ++this.request;
    const { api, router, stage, tasks } = this.context;
    this.wanted = router.address.task ?? stage.world?.task.short_name ?? null;
    await this.trying(request, () => this.context.meet(this.wanted));
    if (request !== this.request) return;
    // An unknown task shows only the error.
    const nowhere = this.wanted !== null && !this.context.task(this.wanted);
    for (const part of [this.rows, this.flights.root]) part.hidden = nowhere;
    if (nowhere) {
      this.choice.value = "";
      this.chosen.hidden = this.ranked.hidden = true;
      this.task = this.drawn = null;
    }
    await this.trying(request, async () => {
      const named = this.wanted ?? (await api.get("episodes", { limit: 1 })).episodes[0]?.task ?? tasks[0].id;
      await this.context.meet(named);
      const board = await api.get(`leaderboard/${encodeURIComponent(named)}`);
      if (request !== this.request) return;
      this.board = board;
      if (this.task?.id !== board.task) {
        this.task = this.context.task(board.task);
        this.runs = null;
        this.ranked.hidden = true;
      }
      this.choice.value = this.task.short_name;
      await Promise.all([this.choose(request), this.flights.show(this.task, board.rows), this.loadRuns(request)]);
    });
  }

  /** Loads the runs, which takes the server a while the first time. */
  async loadRuns(request) {
    const runs = await this.context.api.get(`leaderboard/${this.board.task}/runs`);
    if (request !== this.request || JSON.stringify(runs) === JSON.stringify(this.runs)) return;
    this.runs = runs;
    this.ranked.hidden = !runs.boards.length && !runs.unranked.length;
    this.ranked.replaceChildren(...runsOf(this.context, runs));
  }

  async choose(request) {
    const { api } = this.context;
    const [a, b] = this.missing.length ? [] : this.pilots;
    const path = b ? `paired/${this.board.task}` : `leaderboard/${this.board.task}/maps`;
    const shown = JSON.stringify([this.board.task, a, b]);
    // Hides the previous choice until the new one is loaded.
    if (this.shown !== shown) this.draw(null);
    this.shown = shown;
    await this.trying(request, async () => {
      const answer = a ? await api.get(path, b ? { a, b } : { agent: a }) : null;
      if (request === this.request && this.shown === shown) this.draw(answer);
    });
  }

  draw(answer) {
    const { context, task, board, pilots, missing } = this;
    const drawn = JSON.stringify([board, pilots, answer]);
    if (this.drawn === drawn) return;
    this.drawn = drawn;
    const two = pilots.length === 2;
    const maps = !two && answer ? mapsOf(context, who(context, pilots[0]), answer.maps) : null;
    const flown = pilots.filter((pilot) => !missing.includes(pilot));
    const table = leaderboard(context, board, flown, maps, (chosen) => this.go(chosen));
    keepFocus(this.rows, () => this.rows.replaceChildren(table));
    const pair = two && answer ? paired(context, task, answer, pilots, board.rows) : [];
    this.chosen.replaceChildren(...(missing.length ? unflown(context, task, missing, pilots) : pair));
    this.chosen.hidden = !this.chosen.childElementCount;
  }

  async trying(request, work) {
    try {
      await work();
      if (request === this.request) this.failed = !(this.problem.hidden = true);
    } catch (error) {
      if (request !== this.request) return;
      this.failed = true;
      this.problem.hidden = false;
      this.problem.textContent = `Could not load the comparison: ${error.message}`;
    }
  }

  onEpisodes(episodes) {
    const newest = episodes.find((episode) => episode.task === this.task?.id)?.id;
    if (newest === undefined || newest === this.newest) return;
    this.newest = newest;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.load(), PAUSE);
  }
}
