// Compare: who flies a task best, two of them map by map, runs over the same maps, trainings, and the newest flights.
import { el } from "./dom.js";
import { Flights } from "./flights.js";
import { title } from "./format.js";
import { leaderboard, mapsOf, paired, runsOf } from "./rankings.js";
import { Training } from "./training.js";

const TOPICS = ["episodes", "training"];
/** Several flights that end at once are one change; so many milliseconds later all is asked for anew. */
const PAUSE = 300;
const MOST = 2;

/** @param {HTMLElement} root An empty section. @param {import("./context.js").Context} context */
export function mount(root, context) {
  const { live, router } = context;
  const compare = new Compare(root, context);
  const training = new Training(root);
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
  live.on("training", ({ curve }) => shown && training.show(curve));
  live.on("episodes", ({ episodes }) => shown && compare.heard(episodes));
  live.on("state", ({ state }) => shown && state === "open" && compare.failed && compare.load());
  look();
}

class Compare {
  constructor(root, context) {
    this.context = context;
    this.asked = 0;
    this.timer = 0;
    this.failed = false;
    /** What is compared: the task as `/tasks` tells it, its leaderboard, and the runs over it. */
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
        el("h2", { text: "Who flies best" }),
        el("div.filters", el("label", { for: "compare-task" }, el("span", { text: "Task" }), this.choice)),
      ),
      this.problem,
      this.rows,
      this.chosen,
      this.ranked,
      this.flights.root,
    );
  }

  /** The pilots that the address names: the maps of one are shown, two are paired. */
  get pilots() {
    return this.context.router.address.pilots.slice(0, MOST);
  }

  go(pilots, task = this.task.short_name) {
    this.context.router.go({ view: "compare", task, pilots });
  }

  /** Another address is shown. */
  look() {
    const { task } = this.context.router.address;
    if (this.task && (task === null || this.known(task) === this.task)) this.choose(this.asked);
    else if (task !== this.wanted) this.load();
  }

  known(name) {
    return this.context.tasks.find((task) => [task.id, task.short_name, task.grader].includes(name));
  }

  /** All anew, as for another task or after flights that have ended. */
  async load() {
    const asked = ++this.asked;
    const { api, router, tasks } = this.context;
    this.wanted = router.address.task;
    await this.trying(asked, () => this.context.meet(this.wanted));
    if (asked !== this.asked) return;
    // Beside what is said of a task that there is not, nothing of another is shown.
    const nowhere = this.wanted !== null && !this.known(this.wanted);
    for (const part of [this.rows, this.flights.root]) part.hidden = nowhere;
    if (nowhere) {
      this.choice.value = "";
      this.chosen.hidden = this.ranked.hidden = true;
      this.task = this.drawn = null;
    }
    await this.trying(asked, async () => {
      const named = this.wanted ?? (await api.get("episodes", { limit: 1 })).episodes[0]?.task ?? tasks[0].id;
      await this.context.meet(named);
      const board = await api.get(`leaderboard/${encodeURIComponent(named)}`);
      if (asked !== this.asked) return;
      this.board = board;
      if (this.task?.id !== board.task) {
        this.task = this.known(board.task);
        this.runs = null;
        this.ranked.hidden = true;
      }
      this.choice.value = this.task.short_name;
      await Promise.all([this.choose(asked), this.flights.show(this.task, board.rows), this.loadRuns(asked)]);
    });
  }

  /** What takes the server a while, the first time. */
  async loadRuns(asked) {
    const runs = await this.context.api.get(`leaderboard/${this.board.task}/runs`);
    if (asked !== this.asked || JSON.stringify(runs) === JSON.stringify(this.runs)) return;
    this.runs = runs;
    this.ranked.hidden = !runs.boards.length && !runs.unranked.length;
    this.ranked.replaceChildren(...runsOf(this.context, runs, this.flights));
  }

  /** Shows the leaderboard, and what is chosen in it. */
  async choose(asked) {
    const { api } = this.context;
    const [a, b] = this.pilots;
    const path = b ? `paired/${this.board.task}` : `leaderboard/${this.board.task}/maps`;
    const shown = JSON.stringify([this.board.task, a, b]);
    // What was chosen before does not stand beside another choice, until that is there.
    if (this.shown !== shown) this.draw(null);
    this.shown = shown;
    await this.trying(asked, async () => {
      const answer = a ? await api.get(path, b ? { a, b } : { agent: a }) : null;
      if (asked === this.asked && this.shown === shown) this.draw(answer);
    });
  }

  draw(answer) {
    const { context, task, board, pilots, flights } = this;
    const drawn = JSON.stringify([board, pilots, answer]);
    if (this.drawn === drawn) return;
    this.drawn = drawn;
    const two = pilots.length === 2;
    const name = (agent) => board.rows.find((row) => row.agent === agent)?.name ?? agent;
    const maps = !two && answer ? mapsOf(context, name(pilots[0]), answer.maps, flights, pilots[0]) : null;
    // Who came here by keys stays where they are.
    const { key } = document.activeElement.dataset;
    this.rows.replaceChildren(leaderboard(context, board, pilots, maps, (chosen) => this.go(chosen)));
    this.chosen.replaceChildren(...(two && answer ? paired(context, task, answer, pilots, name, board.rows) : []));
    this.chosen.hidden = !two || !answer;
    if (key) this.rows.querySelector(`[data-key="${CSS.escape(key)}"]`)?.focus();
  }

  /** Says what goes wrong, unless something else has been asked for meanwhile. */
  async trying(asked, work) {
    try {
      await work();
      if (asked === this.asked) this.failed = !(this.problem.hidden = true);
    } catch (error) {
      if (asked !== this.asked) return;
      this.failed = true;
      this.problem.hidden = false;
      this.problem.textContent = `This could not be compared: ${error.message}`;
    }
  }

  /** Flights have ended, by whomever. */
  heard(episodes) {
    const newest = episodes.find((episode) => episode.task === this.task?.id)?.id;
    if (newest === undefined || newest === this.newest) return;
    this.newest = newest;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.load(), PAUSE);
  }
}
