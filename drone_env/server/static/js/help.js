// The help dialog: a summary and the keys.
import { TOUCH } from "./base.js";
import { el } from "./dom.js";
import { scoring } from "./format.js";
import { LAYERS } from "./layers.js";

export const ABOUT =
  "A drone delivers parcels on a city grid before its battery is empty. Fly it yourself, or watch an agent fly.";

const TOUCHES = [
  ["Arrows, or swipe on the map", "Fly, if you are the pilot"],
  ["Wait", "Charge on a blue pad"],
  ["Two fingers on the map", "Move and zoom the map"],
  ["Tap a cell", "What it is and costs"],
];
const KEYS = [
  ["↑ ↓ ← → or W A S D", "Fly, if you are the pilot"],
  ["Space", "Start or pause; wait, if you fly"],
  ["Enter", "Start a race that you fly in"],
  ["U", "Undo your last move"],
  ["← → Home End", "Previous, next, first, last step"],
  [".", "Next step"],
  ["F", "Fly on from this step yourself"],
  ["N R", "New map; restart this map"],
  ["+ −", "Zoom in, zoom out"],
  ["Shift ↑ ↓ ← →", "Move the map while it is zoomed in"],
  ["< >", "Slower, faster"],
  ["1 to 9", "Select a flight"],
  ...LAYERS.filter(({ key }) => key).map(({ key, name }) => [key.toUpperCase(), name]),
  ["?", "This help"],
];

const dialog = document.getElementById("help");

/** Whether there is a mouse, and so a keyboard. */
const MOUSE = matchMedia("(any-pointer: fine)").matches;

/** @param {Context} context */
export function help({ stage, tasks }) {
  const close = () => dialog.close();
  const rows = [...(TOUCH ? TOUCHES : []), ...(TOUCH && !MOUSE ? [] : KEYS)];
  dialog.replaceChildren(
    el("h2", { id: "help-title", text: "Help", tabindex: "-1", autofocus: "" }),
    el("p", { text: ABOUT }),
    el("p", { text: scoring(stage.world?.task ?? tasks[0]) }),
    el("dl.keys", ...rows.flatMap(([key, what]) => [el("dt", el("kbd", { text: key })), el("dd", { text: what })])),
    el(
      "div.dialog-actions",
      el("button.button.primary", { text: "Close", press: close }),
      el("a.button", { href: "?view=learn", text: "Learn to fly", press: close }),
    ),
  );
  dialog.showModal();
}

// A click outside closes it.
dialog.addEventListener("click", ({ target }) => target === dialog && dialog.close());
