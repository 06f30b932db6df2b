// Compare: boards of pilots, pairs, the newest flights, how to add results, and training curves.
import { announce, el, keepFocus, snippet } from "./dom.js";
import { Flights } from "./flights.js";
import { counted, inWords, title, variants, who } from "./format.js";
import { mapsOf, ranking, unflown } from "./rankings.js";
import { mountTraining } from "./training.js";

const TOPICS = ["episodes", "training"];
/** Milliseconds between the end of a flight and the reload, which may cover several flights. */
const PAUSE = 300;
const MOST = 2;
const HOW = "Click a name to open its maps. Tick two pilots to compare them over their common maps.";

/** @param {HTMLElement} root @param {Context} context */
export function mount(root, context) {
  const { api, server, router } = context;
  const training = el("div");
  const compare = new Compare(root, context, training);
  const train = mountTraining(training);
  let shown = false;
  const look = () => {
    const before = shown;
    shown = router.address.view === "compare";
    if (shown && !before) server.watch(TOPICS);
    if (shown) compare.show(!before);
  };
  router.on("address", look);
  server.on("training", async () => shown && train(await api.get("logs/curve")));
  server.on("episodes", ({ episodes }) => shown && compare.onEpisodes(episodes));
  server.on("state", ({ state }) => shown && state === "open" && compare.stale && compare.show());
  look();
}

/** One board for each set of maps that runs flew, and one for the flights of the server. @param {Context} context */
function boardsOf(context, { rows, forks }, { boards, unranked }) {
  const ofRun = (row) => ({
    ...row,
    key: `${row.run}/${row.agent}`,
    pilot: row.agent,
    name: who(context, row.agent),
    remark: row.prompt ? ` by ${row.prompt}` : "",
  });
  const marked = " ! More than 5 % of the answers were unusable. The drone waited at these steps.";
  const by = (of) => [...new Set(of.map(({ run }) => run))].join(", ");
  const largestFirst = [...boards].sort((x, y) => y.rows[0].maps - x.rows[0].maps);
  const runs = largestFirst.map(({ maps, rows: of }) => ({
    name: `Over ${counted(of[0].maps, "map")}`,
    caption: `Runs over ${maps}, best first`,
    note: `${by(of)}: means over ${maps}, with 95 % intervals. ${HOW}${of.some((row) => row.marked) ? marked : ""}`,
    rows: of.map(ofRun),
  }));
  const left = unranked.map(({ run, reason }) => `${run}: ${reason}`);
  if (left.length) runs.push({ name: "Not ranked", caption: "", note: left.join("; "), rows: [] });
  const own = rows.length
    ? `Each row gives means over the maps that the pilot flew, with its 95 % confidence interval, not corrected for the number of rows. The pilot that loses least against the optimum of each map is first. “Few” means under 30 maps. ${HOW}`
    : "No flights of this task yet. Fly it to add one.";
  const flown = {
    name: "Flights on this server",
    caption: "Leaderboard, smallest loss first",
    note: forks ? `${own} Flights that continue another flight do not count (${forks}).` : own,
    rows: rows.map((row) => ({ ...row, key: row.agent, pilot: row.by.pilot, name: inWords(context, row.by) })),
  };
  return [...runs, flown];
}

/** The commands whose results appear here. */
function addingTo({ short_name: task }, rows) {
  const agents = rows.filter(({ shipped }) => shipped).map(({ agent }) => agent);
  const evaluate = (of, name) => `drone-env evaluate --task ${task} --agents ${of} --out data/evaluations/${name}`;
  return el(
    "section.compare-part",
    el("h2", { text: "Add results" }),
    el("p.note", {
      text: "A result appears here if its folder is in the data folder of this server (DRONE_ENV_DATA, by default data): evaluations in evaluations, runs of language models in llm.",
    }),
    el(
      "div.snippets",
      agents.length ? snippet("The agents of the package", evaluate(agents.join(" "), "again")) : "",
      snippet("Your agent: the function act in my_agent.py", evaluate("my_agent:act greedy", "mine")),
      snippet("A language model", `drone-env infer --task ${task} --split test --episodes 20 --out data/llm/mine`),
    ),
  );
}

class Compare {
  constructor(root, context, training) {
    this.context = context;
    this.training = training;
    this.request = 0;
    this.timer = 0;
    /** Whether the boards have to be loaded. */
    this.stale = true;
    this.task = null;
    this.boards = [];
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
    this.flights = new Flights(context);
    this.parts = el("div.compare-parts", el("p.note", { text: "Loading the results…" }));
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
    this.opened = this.maps = this.pairing = null;
    this.ticked = [];
    this.everyone = false;
    /** What happened to the pilot that a third one replaced. */
    this.full = "";
    this.listed = new Set();
  }

  /** The pilots of the address: one shows its maps, two are compared. */
  get pilots() {
    return this.context.router.address.pilots.slice(0, MOST);
  }

  get rows() {
    return this.boards.flatMap(({ rows }) => rows);
  }

  /** The row of a key. An agent without a run means the flights on this server, or else the first run. */
  row(key) {
    return this.rows.find((row) => row.key === key) ?? this.rows.find(({ agent }) => agent === key);
  }

  go(pilots, task = this.choice.value) {
    this.context.router.go({ view: "compare", task, pilots });
  }

  /** A single tick is not in the address, and moves nothing. A third one replaces the first. */
  tick(key, ticked) {
    const others = this.ticked.filter((one) => one !== key);
    const [first] = others;
    this.ticked = ticked ? [...others, key].slice(-MOST) : others;
    // Not a toast, which would move the rows.
    this.full = "";
    if (ticked && others.length === MOST) {
      this.full = `Two pilots at most: ${this.row(key).name} takes the place of ${this.row(first).name}.`;
      announce(this.full);
    }
    const pilots = this.ticked.length === MOST ? this.ticked : this.opened ? [this.opened] : [];
    if (String(pilots) === String(this.pilots)) this.draw();
    else this.go(pilots);
  }

  /** Shows the address. @param {boolean} entered Whether another view was shown before. */
  show(entered = false) {
    this.showing = this.answer(entered);
  }

  async answer(entered) {
    const request = ++this.request;
    const { api, router, stage, tasks } = this.context;
    const before = entered ? stage.world?.task : this.task;
    const newest = async () => (await api.get("episodes", { limit: 1 })).episodes[0]?.task ?? tasks[0].id;
    try {
      const named = router.address.task ?? before?.short_name ?? (await newest());
      await this.context.meet(named);
      if (request !== this.request) return;
      const task = this.context.task(named);
      this.stale ||= entered || task !== this.task;
      // From now on a choice, and a flight that ends, are of this task.
      this.choice.value = task?.short_name ?? null;
      if (this.stale) {
        const path = `leaderboard/${encodeURIComponent(named)}`;
        // All parts appear together, so that none moves another.
        const flights = task && this.flights.load(task);
        const [board, runs] = await Promise.all([api.get(path), api.get(`${path}/runs`), flights]);
        if (request !== this.request) return;
        if (this.task !== task) this.reset();
        this.task = task;
        this.boards = boardsOf(this.context, board, runs);
        this.flights.offer(board.rows);
      }
      this.choose();
      if (!this.stale) this.draw();
      this.stale = false;
      const answers = await this.ask();
      if (request !== this.request) return;
      Object.assign(this, answers);
      this.problem.hidden = true;
      this.parts.hidden = false;
      this.draw();
    } catch (error) {
      if (request !== this.request) return;
      this.stale = true;
      this.problem.hidden = false;
      this.problem.textContent = `Could not load the comparison: ${error.message}`;
      if (error.status !== 404) return;
      // An unknown task shows only the error.
      this.parts.hidden = true;
      this.task = null;
    }
  }

  /** Opens and ticks the rows of the address. */
  choose() {
    const flown = this.pilots.map((pilot) => this.row(pilot)?.key).filter(Boolean);
    if (this.pilots.length === MOST) this.ticked = flown;
    else {
      this.opened = flown[0] ?? null;
      if (this.ticked.length === MOST) this.ticked = [];
    }
  }

  /** Asks for the maps of the opened row, and for the pair. */
  async ask() {
    const { api } = this.context;
    const { id } = this.task;
    const row = this.row(this.opened);
    const both = this.ticked.map((key) => this.row(key));
    const [a, b] = both;
    const [maps, pairing] = await Promise.all([
      row && api.get(`leaderboard/${id}/maps`, { agent: row.agent, run: row.run }),
      b && api.get(`paired/${id}`, { a: a.agent, b: b.agent, run_a: a.run, run_b: b.run }),
    ]);
    const opened = maps && { key: row.key, maps: maps.maps };
    const same = JSON.stringify([this.maps?.key, this.maps?.maps]) === JSON.stringify([opened?.key, opened?.maps]);
    return { maps: same ? this.maps : opened, pairing: pairing && { ...pairing, both } };
  }

  /** The maps of the opened row, which keep their order while other parts are drawn again. */
  detail(row) {
    if (this.maps?.key !== row.key) return false;
    this.maps.shown ??= mapsOf(this.context, this.task, row, this.maps.maps);
    return this.maps.shown;
  }

  draw(everyone = this.everyone) {
    this.everyone = everyone;
    const { context, task, boards, pilots, opened, ticked, maps, pairing } = this;
    // Chosen pilots stay listed, so that no row moves when a box is unticked.
    for (const pilot of [opened, ...ticked]) this.listed.add(pilot);
    const drawn = JSON.stringify([boards, pilots, opened, ticked, everyone, maps?.maps, pairing, this.full]);
    if (this.drawn === drawn) return;
    this.drawn = drawn;
    const missing = pilots.filter((pilot) => !this.row(pilot));
    keepFocus(this.parts, () =>
      this.parts.replaceChildren(
        missing.length ? unflown(context, task, missing, pilots) : "",
        ...boards.map((board) => ranking(context, board, this)),
        this.flights.root,
        variants(task) ? addingTo(task, this.rows) : "",
        this.training,
      ),
    );
  }

  onEpisodes(episodes) {
    const task = this.context.task(this.choice.value)?.id;
    const newest = episodes.find((episode) => episode.task === task)?.id;
    if (newest === undefined || newest === this.newest) return;
    this.newest = newest;
    clearTimeout(this.timer);
    this.timer = setTimeout(async () => {
      // Flights that keep ending never stop the boards from being loaded.
      await this.showing;
      this.stale = true;
      this.show();
    }, PAUSE);
  }
}
