// Compare: leaderboard, pairs, runs over the same maps, training curves and newest flights.
import { el, keepFocus } from "./dom.js";
import { Flights } from "./flights.js";
import { title } from "./format.js";
import { leaderboard, paired, runsOf, unflown } from "./rankings.js";
import { mountTraining } from "./training.js";

const TOPICS = ["episodes", "training"];
/** Milliseconds between the end of a flight and the reload, which may cover several flights. */
const PAUSE = 300;
const MOST = 2;

/** @param {HTMLElement} root @param {Context} context */
export function mount(root, context) {
  const { api, server, router } = context;
  const compare = new Compare(root, context);
  const train = mountTraining(root);
  let shown = false;
  const look = () => {
    const before = shown;
    shown = router.address.view === "compare";
    if (shown && before) compare.look();
    else if (shown) {
      server.watch(TOPICS);
      compare.load();
    }
  };
  router.on("address", look);
  server.on("training", async () => shown && train(await api.get("logs/curve")));
  server.on("episodes", ({ episodes }) => shown && compare.onEpisodes(episodes));
  server.on("state", ({ state }) => shown && state === "open" && compare.failed && compare.load());
  look();
}

class Compare {
  constructor(root, context) {
    this.context = context;
    this.request = 0;
    this.timer = 0;
    this.failed = false;
    this.task = this.board = null;
    this.reset();
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
    this.parts = el("div.compare-parts", this.rows, this.chosen, this.ranked, this.flights.root);
    root.append(
      el(
        "div.view-head",
        el("h2", { text: "Leaderboard" }),
        el("div.filters", el("label", { for: "compare-task" }, el("span", { text: "Task" }), this.choice)),
      ),
      this.problem,
      this.parts,
    );
  }

  /** The row that shows its maps, the boxes that are ticked, the answers for these, and who is listed whatever the rank. */
  reset() {
    this.opened = this.runs = this.maps = this.pairing = null;
    this.ticked = [];
    this.everyone = false;
    this.listed = new Set();
  }

  /** The pilots of the address: one shows its maps, two are compared. */
  get pilots() {
    return this.context.router.address.pilots.slice(0, MOST);
  }

  go(pilots, task = this.task.short_name) {
    this.context.router.go({ view: "compare", task, pilots });
  }

  open(agent) {
    this.go(this.opened === agent ? [] : [agent]);
  }

  /** A single tick is not in the address, and moves nothing. A third one replaces the first. */
  tick(agent, ticked) {
    const others = this.ticked.filter((one) => one !== agent);
    this.ticked = ticked ? [...others, agent].slice(-MOST) : others;
    const pilots = this.ticked.length === MOST ? this.ticked : this.opened ? [this.opened] : [];
    if (String(pilots) === String(this.pilots)) this.draw();
    else this.go(pilots);
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
    await this.trying(request, async () => {
      const named = this.wanted ?? (await api.get("episodes", { limit: 1 })).episodes[0]?.task ?? tasks[0].id;
      await this.context.meet(named);
      if (request !== this.request) return;
      // An unknown task shows only the error.
      this.parts.hidden = !this.context.task(named);
      if (this.parts.hidden) this.task = this.choice.value = null;
      const board = await api.get(`leaderboard/${encodeURIComponent(named)}`);
      if (request !== this.request) return;
      this.board = board;
      if (this.task?.id !== board.task) {
        this.task = this.context.task(board.task);
        this.reset();
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
    const { api, router } = this.context;
    const { task, rows } = this.board;
    const { address } = router;
    const agents = rows.map(({ agent }) => agent);
    const flown = this.pilots.filter((pilot) => agents.includes(pilot));
    if (this.pilots.length === MOST) this.ticked = flown;
    else {
      this.opened = flown[0] ?? null;
      if (this.ticked.length === MOST) this.ticked = [];
    }
    this.draw();
    const [a, b] = this.ticked;
    await this.trying(request, async () => {
      const [maps, pairing] = await Promise.all([
        this.opened && api.get(`leaderboard/${task}/maps`, { agent: this.opened }),
        b && api.get(`paired/${task}`, { a, b }),
      ]);
      if (request !== this.request || address !== router.address) return;
      [this.maps, this.pairing] = [maps, pairing && { ...pairing, pilots: [a, b] }];
      this.draw();
    });
  }

  draw(everyone = this.everyone) {
    this.everyone = everyone;
    const { context, task, board, pilots, opened, ticked, maps, pairing } = this;
    // Chosen pilots stay listed, so that no row moves when a box is unticked.
    for (const pilot of [opened, ...ticked]) this.listed.add(pilot);
    const drawn = JSON.stringify([board, pilots, opened, ticked, everyone, maps, pairing]);
    if (this.drawn === drawn) return;
    this.drawn = drawn;
    keepFocus(this.rows, () => this.rows.replaceChildren(leaderboard(context, board, this)));
    const missing = pilots.filter((pilot) => !board.rows.some(({ agent }) => agent === pilot));
    const pair = ticked.length === MOST && pairing ? paired(context, task, pairing, board.rows) : [];
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
