// The visitor flies: a pad of buttons for touch and mouse, swipes on the map. Keys are in keys.js.
import { el, icon } from "./dom.js";

const ARROW = {
  UP: "M12 19V6M6 11l6-6 6 6",
  DOWN: "M12 5v13M6 13l6 6 6-6",
  LEFT: "M19 12H6M11 6l-6 6 6 6",
  RIGHT: "M5 12h13M13 6l6 6-6 6",
  WAIT: "!M9 9h6v6H9z",
};
const WORDS = { UP: "Up", DOWN: "Down", LEFT: "Left", RIGHT: "Right", WAIT: "Wait" };
const SWIPE = 24;

/** @param {HTMLElement} root @param {import("./context.js").Context} context @param {import("./fleet.js").Fleet} fleet */
export function mountHuman(root, context, fleet) {
  const buttons = Object.entries(ARROW).map(([direction, drawing]) => {
    const press = () => fleet.fly(direction);
    return el("button.pad-button", { data: { direction }, "aria-label": WORDS[direction], press }, icon(drawing));
  });
  const pad = el("div.pad", { role: "group", "aria-label": "Fly", hidden: true }, ...buttons);
  root.append(pad);

  function update() {
    const own = fleet.shown ? fleet.tracks[fleet.human] : undefined;
    pad.hidden = !own;
    for (const button of buttons) button.disabled = own?.done ?? true;
    document.body.classList.toggle("human-flies", Boolean(own) && !own.done);
  }

  fleet.on("setup", update);
  context.stage.on("change", update);
  listenToSwipes(document.getElementById("boards"), fleet);
  update();
}

function listenToSwipes(boards, fleet) {
  let from = null;
  boards.addEventListener("pointerdown", (event) => {
    from = event.isPrimary && event.pointerType !== "mouse" ? [event.clientX, event.clientY] : null;
  });
  boards.addEventListener("pointerup", (event) => {
    if (!from || fleet.human < 0) return;
    const dx = event.clientX - from[0];
    const dy = event.clientY - from[1];
    from = null;
    if (Math.max(Math.abs(dx), Math.abs(dy)) < SWIPE) return;
    if (Math.abs(dx) > Math.abs(dy)) fleet.fly(dx > 0 ? "RIGHT" : "LEFT");
    else fleet.fly(dy > 0 ? "DOWN" : "UP");
  });
}
