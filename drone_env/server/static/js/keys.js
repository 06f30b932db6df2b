// The keyboard: everything on the stage without a mouse.
import { SPEEDS } from "./fleet.js";
import { isFlown } from "./router.js";

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

/**
 * @param {import("./context.js").Context} context @param {import("./fleet.js").Fleet} fleet
 * @param {{help: () => void}} actions
 */
export function mountKeys(context, fleet, { help }) {
  const flick = (id) => {
    const box = document.getElementById(id);
    if (box && !box.disabled) box.click();
  };
  const scrub = (by) => fleet.active.forEach((player) => player.seek(player.cursor + by));
  const faster = (by) => {
    const at = SPEEDS.indexOf(fleet.speed) + by;
    if (at >= 0 && at < SPEEDS.length) fleet.setSpeed(SPEEDS[at]);
  };
  const KEYS = {
    " ": () => fleet.toggle(),
    ".": () => fleet.step(),
    n: () => fleet.start({ seed: null }),
    r: () => fleet.start(),
    "+": () => faster(1),
    "=": () => faster(1),
    "-": () => faster(-1),
    ArrowLeft: () => scrub(-1),
    ArrowRight: () => scrub(1),
    Home: () => scrub(-Infinity),
    End: () => scrub(Infinity),
    g: () => flick("show-ghost"),
    q: () => flick("show-arrows"),
  };

  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
    if (taken(event)) return;
    if (event.key === "?") {
      help();
      return;
    }
    if (!isFlown(context.view)) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const direction = fleet.human >= 0 && !fleet.over ? FLY[key] : undefined;
    if (direction) fleet.fly(direction);
    else if (KEYS[key]) KEYS[key]();
    else return;
    event.preventDefault();
  });
}

/** Whether the focused element needs the key for itself. */
export function taken({ target, key }) {
  if (target.matches("textarea, select, input:not([type=radio], [type=checkbox], [type=range])")) return true;
  const arrow = key.startsWith("Arrow") || key === "Home" || key === "End";
  if (target.matches("input[type=range], .events, .moves, pre")) return arrow;
  if (target.matches("input[type=radio]")) return arrow || key === " ";
  return target.matches("button, a, summary, input[type=checkbox]") && (key === " " || key === "Enter");
}
