// The bar of 100 points: what a score means, what is won and lost in flight, and the parts of a final score.
import { el } from "./dom.js";
import { fixed, optimumOf, pointsBetween } from "./format.js";

/** @typedef {[kind: string, points: number, words: string]} Part */

/** Fills an element with a bar and its legend. @returns {(parts: Part[], digits?: number) => void} Draws the parts. */
export function pointsBar(root) {
  const bar = el("div.points", { "aria-hidden": "true" });
  const legend = el("p.points-legend");
  root.append(bar, legend);
  let drawn = "";
  return (parts, digits = 1) => {
    if (drawn === JSON.stringify(parts)) return;
    drawn = JSON.stringify(parts);
    bar.replaceChildren(...parts.map(([kind, value]) => el("i", { data: { kind }, style: { "--points": String(value) } })));
    legend.replaceChildren(
      ...parts.map(([kind, value, words]) =>
        el("span", { data: { kind } }, el("strong", { text: fixed(value, digits) }), ` ${words}`),
      ),
    );
  };
}

/** What a score counts, below the headline. @param {Context} context */
export function mountMeaning(context) {
  const { task } = document.getElementById("hello").dataset;
  const { score_weights: weights, efficiency_needs_all: all } = context.task(task);
  const root = el("div.meaning");
  document.getElementById("hello").append(root);
  const parcels = all ? "parcels; once all are delivered, also" : "parcels";
  const words = { parcels, battery: "battery left", steps: "steps left" };
  pointsBar(root)(
    Object.entries(weights).map(([kind, points]) => [kind, points, words[kind]]),
    0,
  );
}

/** What is won, still possible and lost at the present step. @param {HTMLElement} root @param {Context} context */
export function mountLivePoints(root, { stage }) {
  const draw = pointsBar(root);
  stage.on("change", () => {
    const { frame, track } = stage;
    root.hidden = !frame;
    if (!frame) return;
    const { done, score, value, deliveries_done: delivered, efficiency_parts: parts } = frame;
    const kept = delivered ? parts[0].score : 0;
    const reached = done ? score : kept;
    const reachable = done ? score : (value ?? 1);
    const [won, possible, lost] = pointsBetween(0, reached, reachable, optimumOf(track) ?? reachable);
    /** @type {Part[]} */
    const rest = [[value === null ? "open" : "possible", possible, value === null ? "open" : "still possible"]];
    if (done) rest.pop();
    if (value !== null) rest.push(["lost", lost, "lost"]);
    draw([["won", won, "won"], ...rest]);
  });
}
