// The help dialog: a summary and the keys.
import { el } from "./dom.js";
import { scoring } from "./format.js";
import { LAYERS } from "./layers.js";

const dialog = document.getElementById("help");
const layers = LAYERS.filter(({ key }) => key);
const keys = layers.flatMap(({ key, name }) => [el("dt", el("kbd", { text: key.toUpperCase() })), el("dd", { text: name })]);
dialog.querySelector(".for-keyboards").append(...keys);

/** @param {Context} context */
export function help({ stage, tasks }) {
  document.getElementById("scoring").textContent = scoring(stage.world?.task ?? tasks[0]);
  dialog.showModal();
}

// A click on the link or outside closes it.
dialog.addEventListener("click", ({ target }) => target instanceof Element && target.matches("dialog, a") && dialog.close());
