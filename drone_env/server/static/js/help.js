// The help dialog: what this is, and the keys.
import { closeBeside, el, fact } from "./dom.js";
import { title } from "./format.js";

const ABOUT =
  "A drone delivers parcels on a city grid before its battery is empty. The score counts parcels first, then battery " +
  "and steps left. Every flight stands beside the exact optimum of its map: what a pilot gives away can never be won " +
  "back.";

/** What flying over a city of a family costs beside the steps, by the numbers of its first task. */
const costs = ([family, [{ drain, impassable }]]) => {
  const parts = Object.entries(drain).map(([kind, units]) => `a step above a ${kind} drains ${units} units of battery`);
  if (impassable.length) parts.push(`cannot be entered: ${impassable.join(", ")}`);
  return parts.length ? fact(title(family), parts.join("; ")) : null;
};

const KEYS = [
  ["Space", "Start or pause; wait, when you fly"],
  [".", "One step"],
  ["← →", "Look back and forth in the flight"],
  ["↑ ↓ ← → or W A S D", "Fly, when you are the pilot"],
  ["N", "New map"],
  ["R", "The same map again"],
  ["+ −", "Faster, slower"],
  ["Q", "Arrows of the network's values"],
  ["G", "Ghost on the best flight"],
  ["?", "This help"],
];

/** @param {import("./context.js").Context} context @returns {() => void} Opens it. */
export function mountHelp({ families, rewardProfiles }) {
  const dialog = document.getElementById("help");
  const close = el("button.button", {
    text: "Close",
    autofocus: "",
    press: () => dialog.close(),
  });
  dialog.append(
    el("h2", { id: "help-title", text: "Mission control" }),
    el("p", {
      text: ABOUT,
    }),
    el(
      "dl.costs",
      ...[...families].map(costs),
      ...rewardProfiles.map(({ id, summary }) => fact(`Rewards ${id}`, summary)),
    ),
    el("dl.keys", ...KEYS.flatMap(([key, what]) => [el("dt", el("kbd", { text: key })), el("dd", { text: what })])),
    el("p.note", "For programs: ", el("a", { href: "docs", text: "the API and its documentation" }), "."),
    el("div.dialog-actions", close),
  );
  closeBeside(dialog);
  const open = () => dialog.showModal();
  document.getElementById("help-button").addEventListener("click", open);
  return open;
}
