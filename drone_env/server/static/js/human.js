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
  const buttons = Object.keys(ARROW).map((direction) =>
    el(
      "button.pad-button",
      {
        data: { direction },
        "aria-label": WORDS[direction],
        press: () => fleet.fly(direction),
      },
      icon(ARROW[direction]),
    ),
  );
  const pad = el("div.pad", { role: "group", "aria-label": "Fly", hidden: true }, ...buttons);
  root.append(pad);

  function update() {
    pad.hidden = fleet.human < 0;
    const over = fleet.human >= 0 && (context.players[fleet.human].last?.done ?? true);
    for (const button of buttons) button.disabled = over;
    root.classList.toggle("human", fleet.human >= 0);
    document.body.classList.toggle("human-flies", !over && fleet.human >= 0);
  }

  fleet.on("setup", update);
  context.on("missions", update);
  context.on("ended", update);
  listenToSwipes(document.getElementById("deck"), fleet);
  update();
}

function listenToSwipes(deck, fleet) {
  let from = null;
  deck.addEventListener("pointerdown", (event) => {
    const onMap = event.target instanceof HTMLCanvasElement && event.target.closest(".map");
    from = onMap && event.pointerType !== "mouse" ? [event.clientX, event.clientY] : null;
  });
  deck.addEventListener("pointerup", (event) => {
    if (!from || fleet.human < 0) return;
    const dx = event.clientX - from[0];
    const dy = event.clientY - from[1];
    from = null;
    if (Math.max(Math.abs(dx), Math.abs(dy)) < SWIPE) return;
    if (Math.abs(dx) > Math.abs(dy)) fleet.fly(dx > 0 ? "RIGHT" : "LEFT");
    else fleet.fly(dy > 0 ? "DOWN" : "UP");
  });
}
