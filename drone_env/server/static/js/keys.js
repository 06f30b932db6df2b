// Keyboard shortcuts and their list in the help, the pad of buttons, and swipes on the map.
import { el, leaveFocus } from "./dom.js";
import { scoring } from "./format.js";
import { STEP } from "./layer_flights.js";
import { LAYERS } from "./layers.js";

const FLY = {
  ArrowUp: "UP",
  ArrowDown: "DOWN",
  ArrowLeft: "LEFT",
  ArrowRight: "RIGHT",
  w: "UP",
  s: "DOWN",
  a: "LEFT",
  d: "RIGHT",
  " ": "WAIT",
};

/** @param {Context} context @param {Race} race */
export function mountKeys(context, race, acts) {
  const { camera, stage } = context;
  const KEYS = {
    " ": acts.toggle,
    Enter: acts.toggle,
    ".": acts.forward,
    n: acts.newMap,
    r: acts.reset,
    f: () => acts.fork(),
    u: acts.undo,
    "+": () => context.emit("camera", camera.nearer(1)),
    "-": () => context.emit("camera", camera.nearer(-1)),
    ArrowLeft: acts.back,
    ArrowRight: acts.forward,
    Home: acts.first,
    End: acts.last,
  };
  for (const arrow of Object.keys(FLY).slice(0, 4)) {
    const [x, y] = STEP[FLY[arrow]];
    KEYS[`Shift${arrow}`] = () => context.emit("camera", camera.pan(-2 * x, -2 * y));
  }
  const dialog = document.getElementById("help");
  const list = dialog.querySelector(".for-keyboards");
  for (const layer of LAYERS.filter(({ key }) => key)) {
    KEYS[layer.key] = () => acts.flick(layer);
    list.append(el("dt", el("kbd", { text: layer.key.toUpperCase() })), el("dd", { text: layer.name }));
  }
  for (let i = 0; i < 9; i++) KEYS[String(i + 1)] = () => stage.select(i);

  function help() {
    document.getElementById("scoring").textContent = scoring(stage.world?.task ?? context.tasks[0]);
    dialog.showModal();
  }
  document.getElementById("help-button").addEventListener("click", help);
  // A click on the link or outside closes it.
  dialog.addEventListener("click", ({ target }) => target instanceof Element && target.matches("dialog, a") && dialog.close());

  // After a choice by mouse or finger, the next key is for the drone, not for the form or the button.
  let pointed = false;
  let clicked = false;
  let flown = "";
  document.addEventListener("pointerdown", () => {
    pointed = true;
    flown = "";
  });
  const leave = ({ target }, what) => pointed && target.matches(what) && target.blur();
  document.addEventListener("click", (event) => leave(event, "input[type=range]"));
  document.addEventListener("focusin", () => (clicked = pointed));
  document.addEventListener("change", (event) => leave(event, "select"));

  document.addEventListener("keydown", (event) => {
    pointed = false;
    if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
    const flies = clicked && race.byHand && context.view === "fly";
    const { target } = event;
    // The speed box takes no arrow from the drone.
    if (flies && (event.key === " " ? isPressed(target) : target instanceof HTMLSelectElement && event.key in FLY)) leaveFocus();
    else if (taken(event)) return;
    if (event.key === "?") {
      help();
      return;
    }
    if (context.view !== "fly") return;
    const moves = event.shiftKey && camera.zoom > 1 && event.key.startsWith("Arrow") ? "Shift" : "";
    const key = event.key.length === 1 ? event.key.toLowerCase() : moves + event.key;
    const direction = race.byHand ? FLY[key] : undefined;
    // At the end of the visitor's flight, a key that is still held does not look back, and one more Space does not
    // replay. A held Space does not toggle.
    const beyond = !direction && (key === " " ? flown || event.repeat : event.repeat && key === flown);
    flown = direction || beyond ? key : "";
    if (direction) race.fly(direction);
    else if (KEYS[key]) beyond || KEYS[key]();
    else return;
    event.preventDefault();
  });
}

const isPressed = (target) => target.matches("button, summary, input[type=checkbox]");

/** Whether the focused element handles the key. */
function taken({ target, key }) {
  if (target.matches("textarea, select, input:not([type=radio], [type=checkbox], [type=range])")) return true;
  const arrow = key.startsWith("Arrow") || key === "Home" || key === "End";
  if (target.matches("input[type=range], .moves, pre")) return arrow;
  if (target.matches("a")) return key === "Enter";
  return isPressed(target) && (key === " " || key === "Enter");
}

const SWIPE = 24;

/** The pad, for touch and mouse, and swipes on the map. @param {HTMLElement} root @param {Context} context @param {Race} race */
export function mountHuman(root, context, race) {
  for (const button of root.querySelectorAll("button")) button.addEventListener("click", () => race.fly(button.dataset.direction));

  function update() {
    root.hidden = !race.mine;
    document.body.classList.toggle("human-flies", !root.hidden);
  }
  race.on("setup", update);
  context.stage.on("change", update);

  const boards = document.getElementById("boards");
  let from = null;
  boards.addEventListener("pointerdown", (event) => {
    from = event.isPrimary && event.pointerType !== "mouse" ? [event.clientX, event.clientY] : null;
  });
  boards.addEventListener("pointerup", (event) => {
    if (!from || race.human < 0) return;
    const dx = event.clientX - from[0];
    const dy = event.clientY - from[1];
    from = null;
    if (Math.max(Math.abs(dx), Math.abs(dy)) < SWIPE) return;
    if (Math.abs(dx) > Math.abs(dy)) race.fly(dx > 0 ? "RIGHT" : "LEFT");
    else race.fly(dy > 0 ? "DOWN" : "UP");
  });
}
