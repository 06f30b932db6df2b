// Tables of Compare: boards of pilots, the maps of a pilot, and pairs.
import { el, fact, keepFocus, scroller, table } from "./dom.js";
import { counted, fixed, isLost, percent, points, shortened, signed, thousands, title, who } from "./format.js";
import { linkOf } from "./router.js";

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

/** Number of rows that a long table shows at first. */
const SHOWN = 100;
/** How the visitor has sorted each long table, and how many rows it shows: flights that end meanwhile draw it again. */
const SORTED = new Map();

/** A long table over maps, sorted by a column with a fourth part: the value of a row. @param {string} by */
function sortable(caption, columns, rows, by) {
  const place = el("div.sortable");
  let { down, most } = SORTED.get(caption) ?? { down: true, most: SHOWN };
  const press = (name) => () => draw(name, by !== name || !down);
  function draw(name, largestFirst, all = false) {
    [by, down, most] = [name, largestFirst, all ? rows.length : most];
    SORTED.set(caption, { by, down, most });
    const value = columns.find(([one]) => one === by)[3];
    const order = [...rows].sort((x, y) => (down ? 1 : -1) * (value(y) - value(x)) || x.seed - y.seed);
    const shown = grid(caption, columns, order.slice(0, most));
    shown.querySelectorAll("th").forEach((head) => {
      const { textContent: text } = head;
      if (!columns.some(([one, , , of]) => one === text && of)) return;
      if (text === by) head.ariaSort = down ? "descending" : "ascending";
      head.replaceChildren(el("button.sort", { text, data: { key: `sort ${text}` }, press: press(text) }));
    });
    const everything = { text: `Show all ${thousands(rows.length)}`, press: () => draw(by, down, true) };
    const more = rows.length > most ? el("button.button.small", everything) : "";
    keepFocus(place, () => place.replaceChildren(shown, more));
  }
  draw(SORTED.get(caption)?.by ?? by, down);
  return place;
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

/** Who flew the flights of a row: the colour of the pilot, the name, and a remark. */
export const named = (context, row, remark = "") =>
  el(
    "span.named",
    el("i.dot", { style: { "--colour": colourOf(context, row) }, "aria-hidden": "true" }),
    el("span", row.name, el("span.margin", { text: remark })),
  );

const open = (text, label, address) =>
  el("a.button.small", { text, "aria-label": label, href: linkOf({ view: "fly", ...address }).search });

/** Whether a pilot of this page flew a row: it flies each map again. */
const flies = (context, task, { pilot, kind = "agent" }) =>
  kind === "agent" && context.pilots.some(({ id, automatic, tasks }) => id === pilot && automatic && tasks.includes(task.id));

/** The end of the flight of a row over a map, or the map for the visitor if the page cannot show it. */
function flightOf(context, task, row, { id, seed, steps }, text = "Open") {
  if (id) return open(text, `Open the flight of ${row.name} over map ${seed}`, { episode: id });
  const map = { task: task.short_name, seed };
  if (!flies(context, task, row)) return open("Fly it", `Fly map ${seed} yourself`, { ...map, pilots: ["human"] });
  const end = { ...map, pilots: [row.pilot], step: Math.ceil(steps) };
  return open(text, `Open the flight of ${row.name} over map ${seed}`, end);
}

/** Means over fewer maps are marked. */
const ENOUGH = 30;
const enough = ({ maps }) => el("span", thousands(maps), el("span.margin", { text: maps < ENOUGH ? " (few)" : "" }));

const opener = (open, key, press, content) =>
  el("button.opener", { "aria-expanded": String(open), data: { key }, press }, content);

/** The share of unusable answers; `!` marks more than 5 %. */
const unusable = ({ unusable_share: share, marked }) =>
  share === null ? "" : `${percent(share, 1)}${marked ? " !" : ""}`;

/** Columns that are shown if they say something. */
const FLIGHTS = ["Flights", (row) => thousands(row.flights), true];
const NORMALISED = ["Random to optimum", (row) => percent(row.normalised), true];
const RUN = ["Run", (row) => el("span.named", row.run)];
const UNUSABLE = ["Unusable answers", unusable, true];

/** The number of people with few maps that are listed at first. */
const PEOPLE = 3;

/** A board of `boardsOf`. @param {any} compare What is open and ticked. */
export function ranking(context, { name, caption, rows, note }, compare) {
  const { task, opened, ticked, everyone, listed } = compare;
  const pick = ({ key, name, run }) =>
    el("input", {
      type: "checkbox",
      checked: ticked.includes(key),
      "aria-label": run ? `Compare ${name} of ${run}` : `Compare ${name}`,
      data: { key: `pick ${key}` },
      on: { change: ({ target }) => compare.tick(key, target.checked) },
    });
  const pilot = (row) => {
    const isOpen = row.key === opened;
    return opener(isOpen, `open ${row.key}`, () => compare.go(isOpen ? [] : [row.key]), named(context, row, row.remark));
  };
  const below = (row) => row.key === opened && compare.detail(row);
  const people = rows.filter(({ pilot, maps }) => pilot === "human" && maps < ENOUGH);
  const more = people.slice(PEOPLE).filter(({ key }) => !listed.has(key));
  const columns = [
    ["Pair", pick],
    ["Pilot", pilot],
    ["Score", (row) => scoreBar(row.score, row.score_ci95, colourOf(context, row))],
    ["Lost", lost, true],
    ["Success", (row) => within(row.success_rate, row.success_ci95, percent), true],
    ["Steps", (row) => fixed(row.steps, 1), true],
    ["Maps", enough, true],
    ...(rows.some(({ flights, maps }) => flights !== maps) ? [FLIGHTS] : []),
    ...(rows.some(({ run }) => run) ? [NORMALISED] : []),
    ...(rows.some(({ run }) => run !== rows[0].run) ? [RUN] : []),
    ...(rows.some(({ prompt }) => prompt) ? [UNUSABLE] : []),
  ];
  const pair = ticked.length > 1 && rows.some(({ key }) => key === ticked.at(-1)) && compare.pairing;
  return el(
    "section.compare-part",
    el("h3", { text: name }),
    rows.length ? grid(caption, columns, everyone ? rows : rows.filter((row) => !more.includes(row)), below) : "",
    more.length ? opener(everyone, "people", () => compare.draw(!everyone), `More people: ${more.length}`) : "",
    el("p.note", { text: note }),
    ...(pair ? [el("p.note", { text: compare.full }), ...paired(context, task, pair)] : []),
  );
}

const regret = ({ optimum, score }) => (optimum === null ? null : optimum - score);
/** Widths of the bars, in points of loss, and their largest number. */
const WIDTHS = [0.5, 1, 2, 5, 10, 20];
const BARS = 12;

/** The maps of a row, below a histogram of losses whose bars select maps. @param {Answer<"Result">[]} maps */
export function mapsOf(context, task, row, maps) {
  const losses = maps.map((map) => (isLost(regret(map)) ? 100 * regret(map) : 0));
  const width = WIDTHS.find((one) => Math.max(...losses) / one < BARS - 1) ?? WIDTHS.at(-1);
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
  const list = (chosen) => place.replaceChildren(sortable(`Maps of ${row.name}`, columns, chosen, "Lost"));
  const bar = (of, i) => {
    const range = i ? `${fixed(width * (i - 1), 1)} to ${fixed(width * i, 1)}` : "0";
    const press = ({ currentTarget: button }) => {
      const on = button.ariaPressed !== "true";
      for (const other of button.parentNode.children) other.ariaPressed = String(on && other === button);
      list(on ? of : maps);
    };
    const title = `Lost ${range}: ${counted(of.length, "map")}`;
    const style = { "--share": of.length / most };
    return el(
      "button.loss",
      { "aria-pressed": "false", "aria-label": title, title, disabled: !of.length, style, press },
      el("span", { text: of.length ? thousands(of.length) : "" }),
      el("i"),
      el("span", { text: i ? fixed(width * i, width % 1 ? 1 : 0) : "0" }),
    );
  };
  list(maps);
  const known = maps.length > 1 && maps.some(({ optimum }) => optimum !== null);
  const about = el("p.note", { text: "Maps by points lost. A bar selects its maps." });
  const histogram = el("div.losses", { role: "group", "aria-label": "Maps by points lost" }, ...bars.map(bar));
  return el("div.maps", ...(known ? [about, histogram] : []), place);
}

const gap = (difference) => signed(difference === null ? null : difference * 100, 1);

/** Two rows over their common maps. @param {Context} context @param {any} answer A `Pairing`, with its `both` rows. */
function paired(context, task, answer) {
  const { both } = answer;
  const pairs = answer.pairs.map((pair) => ({ ...pair, seed: pair.a.seed, optimum: pair.a.optimum }));
  const [a, b] = both.map(({ name }) => name);
  const head = el("h2", named(context, both[0]), " against ", named(context, both[1]));
  if (!answer.maps) return [head, el("p.note", { text: "No common maps yet." })];
  const interval = answer.ci95 ? `95 %: ${answer.ci95.map(gap).join(" to ")}` : "no interval for one map";
  const together = { task: task.short_name, pilots: both.map(({ pilot }) => pilot) };
  const fly = ({ seed }) => open("Fly both", `Fly both over map ${seed}`, { ...together, seed });
  const each = (pair) => both.map((row, i) => flightOf(context, task, row, pair["ab"[i]], shortened(row.name)));
  const ours = both.every((row) => flies(context, task, row));
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
    ["", (pair) => el("span.buttons", ...(ours ? [fly(pair)] : each(pair)))],
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
    sortable(`${a} against ${b}`, columns, pairs, "Difference"),
  ];
}

/** Pilots of the address that no row has, with a link that lets all pilots fly. @param {Context} context */
export function unflown(context, task, missing, pilots) {
  const able = pilots.filter((pilot) => flies(context, task, { pilot }));
  const names = missing.map((agent) => who(context, agent)).join(" or ");
  const address = { task: task.short_name, pilots: able };
  const fly = able.length ? open("Fly now", `Fly ${able.join(" and ")} now`, address) : "";
  return el("p", { role: "status" }, `No flights of ${title(task.short_name)} by ${names} yet. `, fly);
}
