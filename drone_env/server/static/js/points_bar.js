// The bar of 100 points: what a score means, what is won and lost in flight, and the parts of a final score.
import { el } from "./dom.js";
import { fixed, optimumOf, pointsBetween } from "./format.js";

/** @typedef {[kind: string, points: number, words: string]} Part */

/** A bar of these parts, and its legend. @param {Part[]} parts */
export function pointsBar(parts, digits = 1) {
  const shown = parts.filter(([kind, value]) => value > 0.01 || kind === "won");
  const bar = shown.map(([kind, value]) => el("i", { data: { kind }, style: { "--points": String(value) } }));
  const legend = shown.map(([kind, value, words]) => el("span", { data: { kind } }, el("strong", fixed(value, digits)), ` ${words}`));
  return [el("div.points", { "aria-hidden": "true" }, ...bar), el("p.points-legend", ...legend)];
}

/** What a score counts, below the headline. @param {Context} context */
export function mountMeaning(context) {
  const { task } = document.getElementById("hello").dataset;
  const { score_weights: weights, efficiency_needs_all: all } = context.task(task);
  const parcels = all ? "parcels; once all are delivered, also" : "parcels";
  const words = { parcels, battery: "battery left", steps: "steps left" };
  const parts = Object.entries(weights).map(([kind, points]) => [kind, points, words[kind]]);
  document.getElementById("hello").append(el("div.meaning", ...pointsBar(/** @type {Part[]} */ (parts), 0)));
}

/** What is won, still possible and lost at the present step. @param {HTMLElement} root @param {Context} context */
export function mountLivePoints(root, { stage }) {
  stage.on("change", () => {
    const { frame, track } = stage;
    root.hidden = !frame;
    if (!frame) return;
    const { done, score, value, deliveries_done: delivered, efficiency_parts: parts } = frame;
    const kept = delivered ? parts[0].score : 0;
    const reached = done ? score : kept;
    const reachable = done ? score : (value ?? 1);
    const [won, possible, lost] = pointsBetween(0, reached, reachable, optimumOf(track) ?? reachable);
    const hidden = value === null;
    root.replaceChildren(
      ...pointsBar([
        ["won", won, "won"],
        [hidden ? "open" : "possible", possible, hidden ? "open" : "still possible"],
        ["lost", lost, "lost"],
      ]),
    );
  });
}
