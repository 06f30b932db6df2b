// Tables of who flies how well: the leaderboard, its rows down to maps, and runs over the same maps.
import { el, fact, table } from "./dom.js";
import { fixed, percent, points, signed } from "./format.js";

/** So many maps are shown at first: those where most was lost. */
const FIRST = 10;

/**
 * A table that scrolls sideways where it has no room.
 *
 * @param {string} caption
 * @param {[string, (row: any) => Node|string, boolean?][]} columns Name, what stands there, whether it is a number.
 * @param {any[]} rows
 * @param {(row: any) => Node|null} [below] What a row has opened.
 */
export function grid(caption, columns, rows, below = () => null) {
  const lines = (row) => {
    const opened = below(row);
    return [
      el("tr", ...columns.map(([, cell, number]) => el(number ? "td.num" : "td", cell(row)))),
      ...(opened ? [el("tr", el("td.opened", { colspan: columns.length }, el("div", opened)))] : []),
    ];
  };
  const names = columns.map(([name, , number]) => [name, number]);
  return el(
    "div.scroller",
    { tabindex: "0", role: "region", "aria-label": caption },
    table("table.table", {}, caption, names, el("tbody", ...rows.flatMap(lines))),
  );
}

/** Where a score lies from 0 to 1, as a bar with its interval as whiskers, beside the number. */
function scoreBar(score, ci, colour) {
  const [low, high] = ci ?? [score, score];
  const style = { "--at": score, "--low": low, "--high": high, "--colour": colour };
  const bar = el("span.bar", { "aria-hidden": "true" }, el("i"), el("b"));
  return el("div.score-bar", { style }, within(score, ci, points), bar);
}

/** A figure and half of its interval; both ends where the range of the figure cuts one of them off. */
function within(value, ci, write) {
  const cut = ci && Math.abs(ci[0] + ci[1] - 2 * value) > 1e-9;
  const margin = cut ? ` [${ci.map(write).join(", ")}]` : ci ? ` ± ${write(ci[1] - value)}` : "";
  return el("span.within", write(value), el("span.margin", { text: margin }));
}

const lost = (row) => {
  const some = row.regret_maps < row.maps && row.regret !== null ? ` on ${row.regret_maps} maps` : "";
  return el("span", within(row.regret, row.regret_ci95, points), some);
};

/** The colour of a pilot; others have none of their own. */
export const colourOf = ({ pilots }, agent) => {
  const pilot = pilots.find(({ id }) => agent === id || agent.startsWith(`${id} `));
  return pilot?.colour ? `var(--pilot-${pilot.colour})` : "var(--ink-3)";
};

/** A button that opens what is below its row. */
const opener = (open, key, ...contents) =>
  el("button.opener", { "aria-expanded": String(open), data: { key } }, ...contents);

/**
 * @param {import("./context.js").Context} context
 * @param {Object} board As `/leaderboard` answers.
 * @param {string[]} chosen Whose maps are open, or who are paired.
 * @param {Node|null} maps What is open below the row of the one that is chosen.
 * @param {(agents: string[]) => void} choose
 */
export function leaderboard(context, board, chosen, maps, choose) {
  if (!board.rows.length) return el("p.note", { text: "Nobody has flown this task yet. Fly it, and it stands here." });
  const isOpen = ({ agent }) => chosen.length === 1 && chosen[0] === agent;
  const pick = ({ agent, name }) => {
    const others = chosen.filter((one) => one !== agent);
    return el("input", {
      type: "checkbox",
      checked: chosen.includes(agent),
      "aria-label": `Compare ${name}`,
      data: { key: `pick ${agent}` },
      // Of three the first one goes.
      on: { change: ({ target }) => choose(target.checked ? [...others, agent].slice(-2) : others) },
    });
  };
  const who = (row) => {
    const button = opener(
      isOpen(row),
      `open ${row.agent}`,
      el("i.dot", { style: { "--colour": colourOf(context, row.agent) }, "aria-hidden": "true" }),
      el("span", row.name, row.kind === "model" ? el("span.margin", { text: " language model" }) : ""),
    );
    button.addEventListener("click", () => choose(isOpen(row) ? [] : [row.agent]));
    return button;
  };
  const columns = [
    ["Pair", pick],
    ["Pilot", who],
    ["Score", (row) => scoreBar(row.score, row.score_ci95, colourOf(context, row.agent))],
    ["Lost", lost, true],
    ["Success", (row) => within(row.success_rate, row.success_ci95, percent), true],
    ["Steps", (row) => fixed(row.steps, 1), true],
    ["Maps", (row) => String(row.maps), true],
    ["Flights", (row) => String(row.flights), true],
    ["Reward", (row) => el("span", fixed(row.reward), el("span.margin", ` ${row.reward_profile ?? ""}`)), true],
  ];
  const how = "A name opens its maps; two that are ticked are compared over the maps that both flew.";
  const forks = board.forks ? ` Flights that fork from another one are left out: ${board.forks}.` : "";
  return el(
    "div",
    grid("Leaderboard, who lost least first", columns, board.rows, (row) => (isOpen(row) ? maps : null)),
    el("p.note.below", {
      text: `Scores times 100, means over the maps that each flew, ± 95 %. Ranked is what was lost of the optimum of each map, since maps differ. ${how}${forks}`,
    }),
  );
}

/**
 * The maps that somebody flew, the worst first; each opens its flight, or lists its flights.
 *
 * @param {import("./context.js").Context} context
 * @param {string} name Who flew, in words.
 * @param {Object[]} maps As `/leaderboard/{task}/maps` answers.
 * @param {import("./flights.js").Flights} flights Where several over one map are listed.
 * @param {string} agent
 */
export function mapsOf(context, name, maps, flights, agent) {
  const regret = ({ optimum, score }) => (optimum === null ? null : optimum - score);
  const sorted = [...maps].sort((x, y) => (regret(y) ?? -1) - (regret(x) ?? -1) || x.seed - y.seed);
  const open = ({ id, seed, flights: count }) => [
    el("button.button.small", {
      text: "Open",
      "aria-label": `Open the flight of ${name} over map ${seed}`,
      press: () => context.router.go({ view: "fly", episode: id }),
    }),
    count > 1 ? el("button.button.small", { text: `${count} flights`, press: () => flights.filter(agent, seed) }) : "",
  ];
  const columns = [
    ["Map", ({ seed }) => String(seed), true],
    ["Lost", (map) => points(regret(map)), true],
    ["Score", ({ score }) => points(score), true],
    ["Optimum", ({ optimum }) => points(optimum), true],
    ["Success", ({ success }) => percent(success), true],
    ["Steps", ({ steps }) => fixed(steps, steps % 1 ? 1 : 0), true],
    // Flights that were flown in another server are not kept here.
    ["", (map) => (map.id ? el("span.buttons", ...open(map)) : "")],
  ];
  return shortened(sorted, FIRST, (shown) => grid(`Maps that ${name} flew, the worst first`, columns, shown));
}

/** The first of many maps, and a button for all of them. */
export function shortened(all, first, draw) {
  if (all.length <= first) return draw(all);
  const more = el("button.button.small.more", { text: `All ${all.length} maps` });
  const part = el("div", draw(all.slice(0, first)), more);
  more.addEventListener("click", () => {
    part.replaceChildren(draw(all));
    part.firstElementChild.focus();
  });
  return part;
}

const figure = (count) => (count === null ? "" : count.toLocaleString());

/** The share of unusable answers, marked if it is above 5 %. */
const unusable = ({ unusable_share: share, marked }) =>
  share === null ? "" : `${percent(share, 1)}${marked ? " !" : ""}`;

/** What only language models have: columns of no board where none flew. */
const OF_MODELS = [
  ["Errored", (row) => figure(row.errored), true],
  ["Unusable answers", unusable, true],
  ["Tokens", (row) => figure(row.tokens), true],
];

/** Agents and language models, on the board of the maps that they flew, each with its maps below. */
export function runsOf(context, { boards, unranked }, flights) {
  const columns = [
    ["Pilot", (row) => el("span", row.agent, el("span.margin", { text: row.prompt ? ` by ${row.prompt}` : "" }))],
    ["Run", (row) => row.run],
    ["Score", (row) => scoreBar(row.score, row.score_ci95, "var(--accent)")],
    ["Lost", (row) => points(row.regret), true],
    ["Success", (row) => percent(row.success_rate), true],
    ["Random to optimum", (row) => percent(row.normalised), true],
    ["Steps", (row) => fixed(row.steps, 1), true],
    ["Flights", (row) => figure(row.flights), true],
  ];
  const shown = (rows) => (rows.some(({ kind }) => kind === "model") ? [...columns, ...OF_MODELS] : columns);
  const maps = (row) => [
    el("summary", { text: `Maps of ${[...new Set([row.agent, row.run])].join(", ")}` }),
    mapsOf(context, row.agent, row.maps, flights, row.agent),
  ];
  const draw = ({ maps: which, rows }) => [
    el("h3", { text: which }),
    grid(`Runs over ${which}, the best first`, shown(rows), rows),
    ...rows.map((row) => el("details", ...maps(row))),
  ];
  const why = ({ run, reason }) => el("li", { text: `${run}: ${reason}` });
  const marked = boards.some(({ rows }) => rows.some((row) => row.marked));
  return [
    el("h2", { text: "Over the same maps" }),
    ...boards.flatMap(draw),
    marked ? el("p.note", { text: "! More than 5 % of the answers were unusable; the drone waited instead." }) : "",
    unranked.length ? el("div.note", "Not ranked:", el("ul", ...unranked.map(why))) : "",
  ];
}

const MOST_PAIRS = 12;
const gap = (difference) => signed(difference === null ? null : difference * 100, 1);

/**
 * Two pilots over the maps that both flew.
 *
 * @param {import("./context.js").Context} context
 * @param {Object} task
 * @param {Object} answer As `/paired` answers.
 * @param {[string, string]} pilots
 * @param {(agent: string) => string} name
 * @param {Object[]} rows Of the leaderboard.
 */
export function paired(context, task, answer, pilots, name, rows) {
  const [a, b] = pilots.map(name);
  const head = el("h2", { text: `${a} against ${b}` });
  if (!answer.maps) return [head, el("p.note", { text: "They have flown no map in common yet." })];
  const interval = answer.ci95 ? `95 %: ${answer.ci95.map(gap).join(" to ")}` : "one map has no interval";
  const ours = pilots.every((pilot) => rows.some(({ agent, kind }) => agent === pilot && kind === "pilot"));
  const go = (address) => () => context.router.go({ view: "fly", ...address });
  const button = (text, label, address) => el("button.button.small", { text, "aria-label": label, press: go(address) });
  const flight = (who, { id }, seed) => button(who, `Open the flight of ${who} over map ${seed}`, { episode: id });
  const open = ({ seed, ...pair }) =>
    ours
      ? [button("Fly both", `Fly both over map ${seed}`, { task: task.short_name, seed, pilots })]
      : [flight(a, pair.a, seed), flight(b, pair.b, seed)];
  const most = Math.max(...answer.pairs.map(({ difference }) => Math.abs(difference)), 1e-9);
  const bar = ({ difference }) => {
    const more = difference > 0;
    const style = { "--share": Math.abs(difference) / most, "--colour": colourOf(context, pilots[more ? 0 : 1]) };
    return el("span.gap", { "aria-hidden": "true", data: { more: String(more) }, style }, el("i"));
  };
  const columns = [
    ["Map", ({ seed }) => String(seed), true],
    ["Difference", ({ difference }) => gap(difference), true],
    ["", bar],
    [a, (pair) => points(pair.a.score), true],
    [b, (pair) => points(pair.b.score), true],
    ["Optimum", ({ optimum }) => points(optimum), true],
    ["", (pair) => el("span.buttons", ...open(pair))],
  ];
  const sorted = [...answer.pairs].sort((x, y) => Math.abs(y.difference) - Math.abs(x.difference) || x.seed - y.seed);
  return [
    head,
    el(
      "dl.paired",
      fact("Difference of scores", `${gap(answer.difference)} (${interval})`),
      fact("Maps that both flew", String(answer.maps)),
      fact(`${a} scores more`, String(answer.wins)),
      fact("Equal", String(answer.ties)),
      fact(`${b} scores more`, String(answer.losses)),
    ),
    shortened(sorted, MOST_PAIRS, (shown) => grid(`${a} against ${b}, the greatest difference first`, columns, shown)),
  ];
}
