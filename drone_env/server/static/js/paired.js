// Two pilots over the maps that both flew.
import { colourOf, grid, shortened } from "./rankings.js";
import { el, fact } from "./dom.js";
import { points, signed } from "./format.js";

const FIRST = 12;
const gap = (difference) => signed(difference === null ? null : difference * 100, 1);

/**
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
    shortened(sorted, FIRST, (shown) => grid(`${a} against ${b}, the greatest difference first`, columns, shown)),
  ];
}
