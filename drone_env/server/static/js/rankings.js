// Tables of Compare: the leaderboard, the maps of a pilot, runs over the same maps, and pairs.
import { el, fact, scroller, table } from "./dom.js";
import { fixed, percent, points, shortened, signed, title, who } from "./format.js";

/**
 * A table that scrolls if it is larger than its place.
 * @param {any[][]} columns Name, content, whether it is a number.
 * @param {(row: any) => Node|false} [below] Details that a row has opened.
 */
export function grid(caption, columns, rows, below = () => false) {
  const lines = (row) => {
    const opened = below(row);
    return [
      el("tr", ...columns.map(([name, cell, number]) => el(number ? "td.num" : "td", { data: { name } }, cell(row)))),
      ...(opened ? [el("tr", el("td.opened", { colspan: columns.length }, el("div", opened)))] : []),
    ];
  };
  const names = columns.map(([name, , number]) => [name, number]);
  return scroller(caption, table("table.table", {}, caption, names, el("tbody", ...rows.flatMap(lines))));
}

function scoreBar(score, ci, colour) {
  const [low, high] = ci ?? [score, score];
  const style = { "--at": score, "--low": low, "--high": high, "--colour": colour };
  const bar = el("span.bar", { "aria-hidden": "true" }, el("i"), el("b"));
  return el("div.score-bar", { style }, within(score, ci, points), bar);
}

/** A value with both ends of its interval. */
function within(value, ci, write) {
  const margin = ci ? ` [${ci.map((end) => write(end)).join(", ")}]` : "";
  return el("span.within", write(value), el("span.margin", { text: margin }));
}

const lost = (row) => {
  const some = row.regret_maps < row.maps && row.regret !== null ? ` on ${row.regret_maps} maps` : "";
  return el("span", within(row.regret, row.regret_ci95, points), some);
};

const colourOf = (context, { pilot }) => `var(--pilot-${context.pilot(pilot).colour})`;

/** A pilot as in a row: its id and its name. */
const known = (context, agent) => ({ agent, pilot: agent, name: who(context, agent) });

/** Who flew the flights of a row: the colour of the pilot, the name, and a remark. */
export const named = (context, row, remark = "") =>
  el(
    "span.named",
    el("i.dot", { style: { "--colour": colourOf(context, row) }, "aria-hidden": "true" }),
    el("span", row.name, el("span.margin", { text: remark })),
  );

/** Means over fewer maps are marked. */
const ENOUGH = 30;
const counted = ({ maps }) => el("span", String(maps), el("span.margin", { text: maps < ENOUGH ? " (few)" : "" }));

const opener = (open, key, press, content) =>
  el("button.opener", { "aria-expanded": String(open), data: { key }, press }, content);

/** The number of people with few maps that are listed at first. */
const PEOPLE = 3;

/** @param {Answer<"Leaderboard">} board From `GET /leaderboard/{task_name}`. @param {any} compare What is open and ticked. */
export function leaderboard(context, board, compare) {
  if (!board.rows.length) return el("p.note", { text: "No flights of this task yet. Fly it to add one." });
  const { opened, ticked, everyone, listed, maps } = compare;
  const isOpen = ({ agent }) => agent === opened;
  const pick = ({ agent, name }) =>
    el("input", {
      type: "checkbox",
      checked: ticked.includes(agent),
      "aria-label": `Compare ${name}`,
      data: { key: `pick ${agent}` },
      on: { change: ({ target }) => compare.tick(agent, target.checked) },
    });
  const pilot = (row) => {
    const remark = row.kind === "model" ? " language model" : "";
    return opener(isOpen(row), `open ${row.agent}`, () => compare.open(row.agent), named(context, row, remark));
  };
  const below = (row) => isOpen(row) && maps?.agent === opened && mapsOf(context, row.name, maps.maps);
  const people = board.rows.filter(({ kind, maps }) => kind === "person" && maps < ENOUGH);
  const more = people.slice(PEOPLE).filter(({ agent }) => !listed.has(agent));
  const rows = everyone ? board.rows : board.rows.filter((row) => !more.includes(row));
  const columns = [
    ["Pair", pick],
    ["Pilot", pilot],
    ["Score", (row) => scoreBar(row.score, row.score_ci95, colourOf(context, row))],
    ["Lost", lost, true],
    ["Success", (row) => within(row.success_rate, row.success_ci95, percent), true],
    ["Steps", (row) => fixed(row.steps, 1), true],
    ["Maps", counted, true],
    ["Flights", (row) => String(row.flights), true],
  ];
  const how = "Click a name to open its maps. Tick two pilots to compare them over their common maps.";
  const forks = board.forks ? ` Flights that continue another flight do not count (${board.forks}).` : "";
  return el(
    "div",
    grid("Leaderboard, smallest loss first", columns, rows, below),
    more.length ? opener(everyone, "people", () => compare.draw(!everyone), `More people: ${more.length}`) : "",
    el("p.note.below", {
      text: `Each row gives means over the maps that the pilot flew, with its 95 % confidence interval, not corrected for the number of rows. The pilot that loses least against the optimum of each map is first. “Few” means under ${ENOUGH} maps. ${how}${forks}`,
    }),
  );
}

/** The maps of a pilot, largest loss first, with a button that opens the flight. @param {Answer<"AgentMap">[]} maps */
function mapsOf(context, name, maps) {
  const regret = ({ optimum, score }) => (optimum === null ? null : optimum - score);
  const sorted = [...maps].sort((x, y) => (regret(y) ?? -1) - (regret(x) ?? -1) || x.seed - y.seed);
  const open = ({ id, seed }) =>
    el("button.button.small", {
      text: "Open",
      "aria-label": `Open the flight of ${name} over map ${seed}`,
      press: () => context.router.go({ view: "fly", episode: id }),
    });
  const columns = [
    ["Map", ({ seed }) => String(seed), true],
    ["Lost", (map) => points(regret(map)), true],
    ["Score", ({ score }) => points(score), true],
    ["Optimum", ({ optimum }) => points(optimum), true],
    ["Success", ({ success }) => percent(success), true],
    ["Steps", ({ steps }) => fixed(steps, steps % 1 ? 1 : 0), true],
    // A flight from another server is not in this store.
    ["", (map) => (map.id ? open(map) : "")],
  ];
  return grid(`Maps of ${name}, largest loss first`, columns, sorted);
}

const figure = (count) => (count === null ? "" : count.toLocaleString());

/** The share of unusable answers; `!` marks more than 5 %. */
const unusable = ({ unusable_share: share, marked }) =>
  share === null ? "" : `${percent(share, 1)}${marked ? " !" : ""}`;

const OF_MODELS = [
  ["Errored", (row) => figure(row.errored), true],
  ["Unusable answers", unusable, true],
  ["Tokens", (row) => (row.tokens !== null && row.without_usage ? "at least " : "") + figure(row.tokens), true],
];

/** Runs of agents and language models, one board per set of maps. @param {Context} context */
export function runsOf(context, { boards, unranked }) {
  const columns = [
    ["Pilot", (row) => named(context, known(context, row.agent), row.prompt ? ` by ${row.prompt}` : "")],
    ["Run", (row) => el("span.named", row.run)],
    ["Score", (row) => scoreBar(row.score, row.score_ci95, colourOf(context, { pilot: row.agent }))],
    ["Lost", (row) => points(row.regret), true],
    ["Success", (row) => percent(row.success_rate), true],
    ["Random to optimum", (row) => percent(row.normalised), true],
    ["Steps", (row) => fixed(row.steps, 1), true],
    ["Flights", (row) => figure(row.flights), true],
  ];
  const shown = (rows) => (rows.some(({ kind }) => kind === "model") ? [...columns, ...OF_MODELS] : columns);
  const maps = (row) => [
    el("summary", { text: `Maps of ${[...new Set([who(context, row.agent), row.run])].join(", ")}` }),
    mapsOf(context, who(context, row.agent), row.maps),
  ];
  const draw = ({ maps: which, rows }) => [
    el("h3", { text: which }),
    grid(`Runs over ${which}, best first`, shown(rows), rows),
    ...rows.map((row) => el("details", ...maps(row))),
  ];
  const why = ({ run, reason }) => el("li", { text: `${run}: ${reason}` });
  const marked = boards.some(({ rows }) => rows.some((row) => row.marked));
  return [
    el("h2", { text: "Over the same maps" }),
    ...boards.flatMap(draw),
    marked ? el("p.note", { text: "! More than 5 % of the answers were unusable. The drone waited at these steps." }) : "",
    unranked.length ? el("div.note", "Not ranked:", el("ul", ...unranked.map(why))) : "",
  ];
}

const gap = (difference) => signed(difference === null ? null : difference * 100, 1);

/** Two pilots over their common maps. @param {Context} context @param {any} answer A `Pairing`, with its `pilots`. */
export function paired(context, task, answer, rows) {
  const { pilots } = answer;
  const both = pilots.map((agent) => rows.find((row) => row.agent === agent) ?? known(context, agent));
  const [a, b] = both.map(({ name }) => name);
  const head = el("h2", named(context, both[0]), " against ", named(context, both[1]));
  if (!answer.maps) return [head, el("p.note", { text: "No common maps yet." })];
  const interval = answer.ci95 ? `95 %: ${answer.ci95.map(gap).join(" to ")}` : "no interval for one map";
  const ours = pilots.every((pilot) => rows.some(({ agent, kind }) => agent === pilot && kind === "pilot"));
  const go = (address) => () => context.router.go({ view: "fly", ...address });
  const button = (text, label, address) => el("button.button.small", { text, "aria-label": label, press: go(address) });
  const flight = (who, { id }, seed) => button(shortened(who), `Open the flight of ${who} over map ${seed}`, { episode: id });
  const open = ({ seed, ...pair }) =>
    ours
      ? [button("Fly both", `Fly both over map ${seed}`, { task: task.short_name, seed, pilots })]
      : [flight(a, pair.a, seed), flight(b, pair.b, seed)];
  const most = Math.max(...answer.pairs.map(({ difference }) => Math.abs(difference)), 1e-9);
  const bar = ({ difference }) => {
    const more = difference > 0;
    const style = { "--share": Math.abs(difference) / most, "--colour": colourOf(context, both[more ? 0 : 1]) };
    return el("span.gap", { "aria-hidden": "true", data: { more: String(more) }, style }, el("i"));
  };
  const columns = [
    ["Map", ({ seed }) => String(seed), true],
    ["Difference", ({ difference }) => gap(difference), true],
    ["", bar],
    [shortened(a), (pair) => points(pair.a.score), true],
    [shortened(b), (pair) => points(pair.b.score), true],
    ["Optimum", ({ optimum }) => points(optimum), true],
    ["", (pair) => el("span.buttons", ...open(pair))],
  ];
  const sorted = [...answer.pairs].sort((x, y) => Math.abs(y.difference) - Math.abs(x.difference) || x.seed - y.seed);
  return [
    head,
    el(
      "dl.paired",
      fact("Difference of scores", `${gap(answer.difference)} (${interval})`),
      fact("Common maps", String(answer.maps)),
      fact(`${a} scores higher`, String(answer.wins)),
      fact("Equal", String(answer.ties)),
      fact(`${b} scores higher`, String(answer.losses)),
    ),
    grid(`${a} against ${b}, largest difference first`, columns, sorted),
  ];
}

/** Pilots of the address that have not flown the task, with a button that lets all pilots of the address fly it. @param {Context} context */
export function unflown(context, task, missing, pilots) {
  const able = pilots.filter((agent) => context.pilots.some(({ id, tasks }) => id === agent && tasks.includes(task.id)));
  const fly = () => context.router.go({ view: "fly", task: task.short_name, pilots: able });
  const names = missing.map((agent) => who(context, agent)).join(" or ");
  return [
    el("p", { role: "status", text: `No flights of ${title(task.short_name)} by ${names} yet.` }),
    able.length ? el("button.button", { text: able.length > 1 ? "Fly both now" : "Fly now", press: fly }) : "",
  ];
}
