// Compare: boards of pilots, maps of one or a pair, the newest flights, how to add results.
import { el, keepFocus, snippet } from "./dom.js";
import { title, variants, who } from "./format.js";
import { boardsOf, boardTable, flightsTable, mapsOf, pairOf } from "./rankings.js";

/** The number of newest flights that are listed. */
const NEWEST = 100;
/** The number of pilots that are compared. */
const MOST = 2;

/** @param {HTMLElement} root @param {Context} context */
export function mountCompare(root, context) {
  const { api, router, server, stage, tasks } = context;
  root.append(document.getElementById("compare").content);
  const choice = root.querySelector("select");
  /** @type {HTMLElement} */
  const problem = root.querySelector(".problem");
  /** @type {HTMLElement} */
  const parts = root.querySelector(".compare-parts");
  const [boards, detail, flights, adding] = /** @type {NodeListOf<HTMLElement>} */ (root.querySelectorAll(".compare-part"));
  const programs = [...adding.querySelectorAll("pre")];
  const option = ({ short_name }) => el("option", { value: short_name, text: title(short_name) });
  for (const [family, all] of context.families) choice.append(el("optgroup", { label: title(family) }, ...all.map(option)));
  context.on("task", (task) => choice.append(option(task)));
  choice.addEventListener("change", () => go(choice.value, []));

  const drawn = new Map();
  /** The task that is asked for, and the one that is shown. */
  let [request, asked, shown, followed] = [0, null, null, false];
  /** Whether the parts are on their way, and whether the news have told more since then than `known`, the listed flights. */
  let [asking, outdated, known] = [false, false, new Set()];
  /** All rows, and those that the address names. */
  let [rows, chosen] = [[], []];

  const go = (task, pilots) => router.go({ view: "compare", task, pilots });
  /** The row of a pilot of the address. An agent without a run means the flights on this server, or else the first run. */
  const rowOf = (pilot) => rows.find(({ key }) => key === pilot) ?? rows.find(({ agent }) => agent === pilot);

  function tick() {
    const ticked = [...boards.querySelectorAll("input")].filter(({ checked }) => checked);
    go(choice.value, ticked.map(({ value }) => value));
  }

  /** Draws a part again if its answer differs. */
  function redraw(part, answer, draw) {
    const text = JSON.stringify(answer);
    if (drawn.get(part) !== text) keepFocus(part, () => part.replaceChildren(...draw()));
    drawn.set(part, text);
  }

  /** The maps of one chosen row, or the pair of two. */
  function ask(task) {
    const [a, b] = chosen;
    if (b) return api.get(`paired/${task.id}`, { a: a.agent, b: b.agent, run_a: a.run, run_b: b.run });
    return a && api.get(`leaderboard/${task.id}/maps`, { agent: a.agent, run: a.run });
  }

  function drawDetail(task, answer, missing) {
    const names = missing.map((pilot) => who(context, pilot)).join(" or ");
    const none = names && el("p", { role: "status", text: `No flights of ${title(task.short_name)} by ${names} yet.` });
    const [row, other] = chosen;
    if (other) return pairOf(context, task, chosen, answer);
    return [none, ...(row ? mapsOf(context, task, row, answer.maps) : [])];
  }

  async function show() {
    const mine = ++request;
    const { pilots, task: name } = router.address;
    const named = name ?? stage.world?.task.short_name ?? tasks[0].short_name;
    [asked, asking, outdated] = [named, true, false];
    // The rows of another task lead to its maps.
    parts.inert = named !== shown;
    try {
      await context.meet(named);
      const path = `leaderboard/${encodeURIComponent(named)}`;
      // Asked before the boards: a flight that they miss is not in `known` either, so its news load them again.
      const { episodes } = await api.get("episodes", { task: named, limit: NEWEST });
      if (mine !== request) return;
      known = new Set(episodes.map((one) => JSON.stringify(one)));
      const [board, runs] = await Promise.all([api.get(path), api.get(`${path}/runs`)]);
      if (mine !== request) return;
      const task = context.task(named);
      choice.value = task.short_name;
      const all = boardsOf(context, board, runs);
      rows = all.flatMap((one) => one.rows);
      chosen = pilots.slice(0, MOST).map(rowOf).filter(Boolean);
      const missing = pilots.filter((pilot) => !rowOf(pilot));
      const answer = await ask(task);
      if (mine !== request) return;
      // All parts appear together, so that none moves another.
      redraw(boards, [task.id, all], () => all.map((one) => boardTable(context, task, one, tick, () => (followed = true))));
      for (const box of boards.querySelectorAll("input")) {
        box.checked = chosen.some(({ key }) => key === box.value);
        box.disabled = !box.checked && chosen.length === MOST;
      }
      redraw(detail, [task.id, chosen, answer, missing], () => drawDetail(task, answer, missing));
      redraw(flights.lastElementChild, [task.id, episodes], () => [flightsTable(context, episodes)]);
      const agents = rows.filter(({ shipped }) => shipped).map(({ agent }) => agent);
      const words = { TASK: task.short_name, AGENTS: agents.join(" ") || "greedy" };
      redraw(adding.lastElementChild, words, () => programs.map((program) => snippet(program, words)));
      flights.hidden = !episodes.length;
      adding.hidden = !variants(task);
      shown = named;
      problem.hidden = true;
      parts.hidden = parts.inert = false;
      if (followed) detail.scrollIntoView({ block: "nearest" });
      followed = false;
    } catch (error) {
      if (mine !== request) return;
      problem.hidden = false;
      problem.textContent = `Could not load the comparison: ${error.message}`;
      // An unknown task shows only the error.
      parts.hidden ||= error.status === 404;
    } finally {
      if (mine === request) asking = false;
    }
    if (mine === request && outdated) show();
  }

  context.on("view", (view) => {
    if (view !== "compare") return;
    server.watch(["episodes"]);
    show();
  });
  server.on("state", ({ state }) => state === "open" && context.view === "compare" && !problem.hidden && show());
  server.on("episodes", ({ episodes }) => {
    const id = context.task(asked)?.id;
    // A flight that ended, or whose optimum is computed.
    if (episodes.every((one) => one.task !== id || known.has(JSON.stringify(one)))) return;
    // The present request shows its answers first: if flights end all the time, the page would otherwise show none.
    outdated = true;
    if (!asking) show();
  });
}
