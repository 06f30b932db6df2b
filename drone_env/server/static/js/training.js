// The curves of the newest training.
import { el } from "./dom.js";
import { fixed, percent, points, title } from "./format.js";

/** The charts of a training, each with its title and number format. */
const DRAWN = {
  validation: ["Score on the validation maps", points],
  success: ["Success", percent],
  loss: ["Loss", (v) => fixed(v, 4)],
  reward: ["Reward", fixed],
};

/** The charts of `GET /logs/curve`, whose first series is the x axis. @param {Record<string, (number|null)[]>} curve */
export function chartsOf(curve) {
  const [count] = Object.keys(curve);
  const drawn = Object.keys(DRAWN).filter((name) => curve[name]?.some((value) => value !== null));
  return drawn.map((name) => chart(name, curve, count));
}

function chart(name, curve, count) {
  const [words, format] = DRAWN[name];
  const at = curve[count];
  const known = curve[name].map((value, i) => [at[i], value]).filter(([, value]) => value !== null);
  const values = known.map(([, value]) => value);
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const across = (x) => (100 * (x - at[0])) / (at.at(-1) - at[0] || 1);
  const up = (value) => 100 - (100 * (value - low)) / (high - low || 1);
  const [last, newest] = known.at(-1);
  const optimum = name === "validation" && curve.optimum?.at(-1);
  const best = optimum ? ` Optimum of these maps: ${format(optimum)}.` : "";
  const line = known.map(([x, value]) => `${across(x)} ${up(value)}`).join("L");
  const label = (place, text) => el(`span.chart-${place}`, { text });
  return el(
    "figure.chart",
    { data: { chart: name } },
    el("figcaption", el("h3", { text: words }), el("p.note", { text: `${format(newest)} at ${count} ${last}.${best}` })),
    el(
      "div.chart-frame",
      { "aria-hidden": "true" },
      // A line of one value is a dot.
      el("svg:svg", { viewBox: "0 0 100 100", preserveAspectRatio: "none" }, el("svg:path", { d: `M${line}h0` })),
      label("high", format(high)),
      label("low", low === high ? "" : format(low)),
      label("from", `${title(count)} ${at[0]}`),
      label("to", String(at.at(-1))),
    ),
  );
}
