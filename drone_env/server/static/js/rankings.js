// Tables of Compare: boards of pilots, the maps of one, the pair of two, and the newest flights.
import { el, fact, grid } from "./dom.js";
import { counted, fixed, flightName, inWords, isLost, moment, outcome, percent, points, shortened, signed, thousands, who } from "./format.js";
import { linkOf } from "./router.js";

/** Means over fewer maps are marked. */
const ENOUGH = 30;
const MARKED = " ! More than 5 % of the answers were unusable. The drone waited at these steps.";

/** One board for each set of maps that runs flew, and one for the flights of the server. @param {Context} context */
export function boardsOf(context, { rows, forks }, { boards, unranked }) {
  const ofRun = (row) => ({
    ...row,
    key: `${row.run}/${row.agent}`,
    pilot: row.agent,
    name: who(context, row.agent),
    remark: row.prompt ? ` by ${row.prompt}` : "",
  });
  const runs = boards.map(({ maps, rows: of }) => ({
    name: `Over ${counted(of[0].maps, "map")}`,
    caption: `Runs over ${maps}, best first`,
    note: `${[...new Set(of.map(({ run }) => run))].join(", ")}: means over ${maps}.${of.some((row) => row.marked) ? MARKED : ""}`,
    rows: of.map(ofRun),
  }));
  runs.sort((x, y) => y.rows[0].maps - x.rows[0].maps);
  const ofServer = rows.map((row) => ({ ...row, key: row.agent, pilot: row.by.pilot, name: inWords(context, row.by) }));
  const isGuest = ({ pilot, maps }) => Number(pilot === "human" && maps < ENOUGH);
  const notes = [
    rows.length ? "" : "No flights of this task yet. Fly it to add one.",
    forks ? `Flights that continue another flight do not count (${forks}).` : "",
    unranked.length ? `Not ranked: ${unranked.map(({ run, reason }) => `${run}: ${reason}`).join("; ")}` : "",
  ];
  const flown = {
    name: "Flights on this server",
    caption: "Leaderboard, smallest loss first",
    note: notes.join(" ").trim(),
    // Many people fly one map, perhaps without a loss.
    rows: ofServer.sort((x, y) => isGuest(x) - isGuest(y)),
  };
  return [...runs, flown];
}

const colourOf = (context, { pilot }) => `var(--pilot-${context.pilot(pilot).colour})`;

/** Who flew the flights of a row: the colour of the pilot, the name, and a remark. */
const named = (context, row, remark = "") =>
  el(
    "span.named",
    el("i.dot", { style: { "--colour": colourOf(context, row) }, "aria-hidden": "true" }),
    el("span", row.name, el("span.margin", { text: remark })),
  );

/** A value with both ends of its interval. */
const within = (value, ci, write) =>
  el("span.within", write(value), el("span.margin", { text: ci ? ` [${ci.map((end) => write(end)).join(", ")}]` : "" }));

function scoreBar(context, row) {
  const { score, score_ci95: ci } = row;
  const [low, high] = ci ?? [score, score];
  const style = { "--at": score, "--low": low, "--high": high, "--colour": colourOf(context, row) };
  return el("div.score-bar", { style }, within(score, ci, points), el("span.bar", { "aria-hidden": "true" }, el("i"), el("b")));
}

const lost = (row) => {
  const some = row.regret_maps < row.maps && row.regret !== null ? ` on ${row.regret_maps} maps` : "";
  return el("span", within(row.regret, row.regret_ci95, points), some);
};

const enough = ({ maps }) => el("span", thousands(maps), el("span.margin", { text: maps < ENOUGH ? " (few)" : "" }));

/** The share of unusable answers; `!` marks more than 5 %. */
const unusable = ({ unusable_share: share, marked }) => (share === null ? "" : `${percent(share, 1)}${marked ? " !" : ""}`);

/** Columns that are shown if they say something. */
const RUN = ["Run", (row) => el("span.named", row.run)];
const UNUSABLE = ["Unusable answers", unusable, true];

/** A board of `boardsOf`. @param {(event: any) => void} tick @param {() => void} press Follows the link of a name. */
export function boardTable(context, task, { name, caption, rows, note }, tick, press) {
  const pick = ({ key, name, run }) =>
    el("input", {
      type: "checkbox",
      value: key,
      "aria-label": run ? `Compare ${name} of ${run}` : `Compare ${name}`,
      data: { key },
      on: { change: tick },
    });
  const pilot = (row) => {
    const { search } = linkOf({ view: "compare", task: task.short_name, pilots: [row.key] });
    return el("a.opener", { href: search, press, data: { key: `maps ${row.key}` } }, named(context, row, row.remark));
  };
  const columns = [
    ["Pair", pick],
    ["Pilot", pilot],
    ["Score", (row) => scoreBar(context, row), false, ({ score }) => score],
    ["Lost", lost, true, ({ regret }) => regret ?? -1],
    ["Success", (row) => within(row.success_rate, row.success_ci95, percent), true, ({ success_rate }) => success_rate],
    ["Steps", (row) => fixed(row.steps, 1), true, ({ steps }) => steps],
    ["Maps", enough, true, ({ maps }) => maps],
    ...(rows.some(({ run }) => run !== rows[0].run) ? [RUN] : []),
    ...(rows.some(({ prompt }) => prompt) ? [UNUSABLE] : []),
  ];
  return el(
    "section.compare-part",
    el("h3", { text: name }),
    rows.length ? grid(caption, columns, rows) : "",
    el("p.note", { text: note }),
  );
}

const open = (text, label, address) => el("a.button.small", { text, "aria-label": label, href: linkOf({ view: "fly", ...address }).search });

/** Whether a pilot of this page flew a row: it flies each map again. */
const flies = (context, task, { pilot, kind = "agent" }) =>
  kind === "agent" && context.pilots.some(({ id, automatic, tasks }) => id === pilot && automatic && tasks.includes(task.id));

/** The end of the flight of a row over a map, or the map for the visitor if the page cannot show it. */
function flightOf(context, task, row, { id, seed, steps }, text = "Open") {
  const label = `Open the flight of ${row.name} over map ${seed}`;
  const map = { task: task.short_name, seed };
  if (id) return open(text, label, { episode: id });
  if (!flies(context, task, row)) return open("Fly it", `Fly map ${seed} yourself`, { ...map, pilots: ["human"] });
  return open(text, label, { ...map, pilots: [row.pilot], step: Math.ceil(steps) });
}

const regret = ({ optimum, score }) => (optimum === null ? null : optimum - score);
/** The largest number of bars above zero. */
const BARS = 12;

/** The maps of a row, below a histogram of losses whose bars select maps. @param {Answer<"Result">[]} maps */
export function mapsOf(context, task, row, maps) {
  const losses = maps.map((map) => (isLost(regret(map)) ? 100 * regret(map) : 0));
  /** Of a bar, in points. */
  const width = Math.max(1, Math.ceil(Math.max(...losses) / BARS));
  const bars = Array.from({ length: Math.ceil(Math.max(...losses) / width) + 1 }, () => []);
  maps.forEach((map, i) => bars[Math.ceil(losses[i] / width)].push(map));
  const most = Math.max(...bars.map(({ length }) => length));
  const columns = [
    ["Map", ({ seed }) => String(seed), true, ({ seed }) => seed],
    ["Lost", (map) => points(regret(map)), true, (map) => regret(map) ?? -1],
    ["Score", ({ score }) => points(score), true, ({ score }) => score],
    ["Optimum", ({ optimum }) => points(optimum), true, ({ optimum }) => optimum ?? -1],
    ["Success", ({ success }) => percent(success), true, ({ success }) => success],
    ["Steps", ({ steps }) => fixed(steps, steps % 1 ? 1 : 0), true, ({ steps }) => steps],
    ["", (map) => flightOf(context, task, row, map)],
  ];
  const place = el("div");
  const list = (chosen) => place.replaceChildren(grid(`Maps of ${row.name}`, columns, chosen, "Lost"));
  const bar = (of, i) => {
    const title = `Lost ${i ? `${width * (i - 1)} to ${width * i}` : "0"}: ${counted(of.length, "map")}`;
    const press = ({ currentTarget: button }) => {
      const on = button.ariaPressed !== "true";
      for (const other of button.parentNode.children) other.ariaPressed = String(on && other === button);
      list(on ? of : maps);
    };
    return el(
      "button.loss",
      { "aria-pressed": "false", "aria-label": title, title, disabled: !of.length, style: { "--share": of.length / most }, press },
      el("span", { text: of.length ? thousands(of.length) : "" }),
      el("i"),
      el("span", { text: String(width * i) }),
    );
  };
  list(maps);
  const known = maps.length > 1 && maps.some(({ optimum }) => optimum !== null);
  const about = el("p.note", { text: "Maps by points lost. A bar selects its maps." });
  const histogram = el("div.losses", { role: "group", "aria-label": "Maps by points lost" }, ...bars.map(bar));
  return [el("h2", "Maps of ", named(context, row, row.remark)), ...(known ? [about, histogram] : []), place];
}

const gap = (difference) => signed(difference === null ? null : difference * 100, 1);

/** Two rows over their common maps. @param {Context} context @param {Answer<"Pairing">} answer */
export function pairOf(context, task, both, answer) {
  const [a, b] = both.map(({ name }) => name);
  const head = el("h2", named(context, both[0]), " against ", named(context, both[1]));
  if (!answer.maps) return [head, el("p.note", { text: "No common maps yet." })];
  const interval = answer.ci95 ? `95 %: ${answer.ci95.map(gap).join(" to ")}` : "no interval for one map";
  const pairs = answer.pairs.map((pair) => ({ ...pair, seed: pair.a.seed, optimum: pair.a.optimum }));
  const ours = both.every((row) => flies(context, task, row));
  const pilots = both.map(({ pilot }) => pilot);
  const flights = ({ seed, ...pair }) =>
    ours
      ? open("Fly both", `Fly both over map ${seed}`, { task: task.short_name, seed, pilots })
      : el("span.buttons", ...both.map((row, i) => flightOf(context, task, row, pair["ab"[i]], shortened(row.name))));
  const most = Math.max(...pairs.map(({ difference }) => Math.abs(difference)), 1e-9);
  const bar = ({ difference }) => {
    const more = difference > 0;
    const style = { "--share": Math.abs(difference) / most, "--colour": colourOf(context, both[more ? 0 : 1]) };
    return el("span.gap", { "aria-hidden": "true", data: { more: String(more) }, style }, el("i"));
  };
  const columns = [
    ["Map", ({ seed }) => String(seed), true, ({ seed }) => seed],
    ["Difference", ({ difference }) => gap(difference), true, ({ difference }) => Math.abs(difference)],
    ["", bar],
    [shortened(a), (pair) => points(pair.a.score), true, (pair) => pair.a.score],
    [shortened(b), (pair) => points(pair.b.score), true, (pair) => pair.b.score],
    ["Optimum", ({ optimum }) => points(optimum), true, ({ optimum }) => optimum ?? -1],
    ["", flights],
  ];
  return [
    head,
    el(
      "dl.paired",
      fact("Difference of scores", `${gap(answer.difference)} (${interval})`),
      fact("Common maps", thousands(answer.maps)),
      fact(`${a} scores higher`, thousands(answer.wins)),
      fact("Equal", thousands(answer.ties)),
      fact(`${b} scores higher`, thousands(answer.losses)),
    ),
    grid(`${a} against ${b}`, columns, pairs, "Difference"),
  ];
}

/** The newest flights of a task. @param {Context} context */
export function flightsTable(context, episodes) {
  const columns = [
    ["Pilot", (e) => named(context, { pilot: e.pilot, name: inWords(context, e) })],
    ["Map", (e) => String(e.seed), true],
    ["Score", (e) => points(e.score), true],
    ["Lost", (e) => points(e.regret), true],
    ["Outcome", outcome],
    ["Parcels", (e) => `${e.deliveries} / ${e.deliveries_total}`, true],
    ["Steps", (e) => String(e.steps), true],
    ["Finished", (e) => el("time", { datetime: e.finished_at, text: moment(e.finished_at) })],
    ["", (e) => open("Open", `Open ${flightName(context, e)}`, { episode: e.id })],
  ];
  return grid("Flights, newest first", columns, episodes);
}
