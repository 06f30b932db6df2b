// The help dialog: what this is, the keys, and where to learn more.
import { closeBeside, el } from "./dom.js";
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
  ["F", "Try from there: fly on yourself from the moment that is shown"],
  ["N R", "New map; the same map again"],
  ["+ −", "Faster, slower"],
  ["Z X", "Nearer, farther"],
  ["1 to 9", "Look at another flight"],
  ...LAYERS.filter(({ key }) => key).map(({ key, name }) => [key.toUpperCase(), name]),
  ["?", "This help"],
];

/** @returns {() => void} Opens it. */
export function mountHelp() {
  const dialog = document.getElementById("help");
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
  closeBeside(dialog);
  const open = () => dialog.showModal();
  document.getElementById("help-button").addEventListener("click", open);
  return open;
}
