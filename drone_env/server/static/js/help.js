// The help dialog: what this is, the keys, and where to learn more.
import { closeBeside, el } from "./dom.js";
import { linkTo } from "./link.js";

/** What this is, in a sentence. */
export const ABOUT =
  "A drone delivers parcels on a city grid before its battery is empty: fly it yourself, or watch others fly.";

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
export function mountHelp({ router }) {
  const dialog = document.getElementById("help");
  const close = () => dialog.close();
  dialog.append(
    el("h2", { id: "help-title", text: "Help" }),
    el("p", { text: ABOUT }),
    el("dl.keys", ...KEYS.flatMap(([key, what]) => [el("dt", el("kbd", { text: key })), el("dd", { text: what })])),
    el(
      "div.dialog-actions",
      el("button.button.primary", { text: "Close", autofocus: "", press: close }),
      linkTo(router, "a.button", { view: "learn" }, "Learn to fly", { on: { click: close } }),
    ),
  );
  closeBeside(dialog);
  const open = () => dialog.showModal();
  document.getElementById("help-button").addEventListener("click", open);
  return open;
}
