// The help dialog: a summary and the keys.
import { el } from "./dom.js";
import { LAYERS } from "./layers.js";

/** A summary of the page. */
export const ABOUT =
  "A drone delivers parcels on a city grid before its battery is empty. Fly it yourself, or watch an agent fly.";

const KEYS = [
  ["↑ ↓ ← → or W A S D", "Fly, if you are the pilot"],
  ["Space", "Start or pause; wait, if you fly"],
  ["Enter", "Start a race that you fly in"],
  ["U", "Undo your last move"],
  ["← → Home End", "Previous, next, first, last step"],
  [".", "Next step"],
  ["F", "Fork the flight at this step and fly it yourself"],
  ["N R", "New map; restart this map"],
  ["+ −", "Zoom in, zoom out"],
  ["Shift ↑ ↓ ← →", "Move the map while it is zoomed in"],
  ["< >", "Slower, faster"],
  ["1 to 9", "Select a flight"],
  ...LAYERS.filter(({ key }) => key).map(({ key, name }) => [key.toUpperCase(), name]),
  ["?", "This help"],
];

const dialog = document.getElementById("help");

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
  // A click outside closes it.
  dialog.addEventListener("click", (event) => event.target === dialog && close());
}
