// The help dialog: what this is, the keys, and where to learn more.
import { el } from "./dom.js";
import { LAYERS } from "./layers.js";

/** What this is, in a sentence. */
export const ABOUT =
  "A drone delivers parcels on a city grid before its battery is empty: fly it yourself, or watch others fly.";

const KEYS = [
  ["↑ ↓ ← → or W A S D", "Fly, when you are the pilot"],
  ["Space", "Start or pause; wait, when you fly"],
  ["U", "Take a move of yours back"],
  ["← → Home End", "Look back and forth in the flight"],
  [".", "The next step"],
  ["F", "Try from here: fly on yourself from the moment that is shown"],
  ["N R", "New map; reset to the start of this one"],
  ["+ −", "Nearer, farther"],
  ["Shift ↑ ↓ ← →", "Move a map that is seen from nearby"],
  ["< >", "Slower, faster"],
  ["1 to 9", "Look at another flight"],
  ...LAYERS.filter(({ key }) => key).map(({ key, name }) => [key.toUpperCase(), name]),
  ["?", "This help"],
];

const dialog = document.getElementById("help");

/** Opens it. */
export function help() {
  if (!dialog.childElementCount) fill();
  dialog.showModal();
}

function fill() {
  const close = () => dialog.close();
  dialog.append(
    el("h2", { id: "help-title", text: "Help" }),
    el("p", { text: ABOUT }),
    el("dl.keys", ...KEYS.flatMap(([key, what]) => [el("dt", el("kbd", { text: key })), el("dd", { text: what })])),
    el(
      "div.dialog-actions",
      el("button.button.primary", { text: "Close", autofocus: "", press: close }),
      el("a.button", { href: "?view=learn", text: "Learn to fly", press: close }),
    ),
  );
  // A click beside it.
  dialog.addEventListener("click", (event) => event.target === dialog && close());
}
