// Below the maps: start, pause, single step, speed, and the strip of the flight.
import { el, icon, setText } from "./dom.js";
import { SPEEDS } from "./fleet.js";
import { nextFrame } from "./loop.js";
import { mountTimeline } from "./timeline.js";

const PLAY = "!M7 4.500v15l13-7.500z";
const PAUSE = "!M7 5h3.500v14H7zM13.500 5H17v14h-3.500z";

/** @param {HTMLElement} root @param {import("./context.js").Context} context @param {import("./fleet.js").Fleet} fleet */
export function mountControls(root, context, fleet) {
  const start = el("button.button.primary", {
    id: "start",
    press: () => fleet.toggle(),
  });
  const step = el(
    "button.button",
    { id: "step", title: "One step (.)", press: () => fleet.step() },
    icon("!M5 5v14l9-7z", "M18 5v14"),
    el("span", { text: "Step" }),
  );
  const again = el(
    "button.icon-button",
    {
      id: "restart",
      title: "Same map again (R)",
      "aria-label": "Fly the same map again",
      press: () => fleet.start(),
    },
    icon("M5 12a7 7 0 1 0 2.200-5.100M5 4v4h4"),
  );
  const speed = el("input", {
    type: "range",
    id: "speed",
    min: "0",
    max: String(SPEEDS.length - 1),
    step: "1",
    on: { input: () => fleet.setSpeed(SPEEDS[Number(speed.value)]) },
  });
  const speedText = el("output", { for: "speed" });
  const bar = el(
    "div.controls",
    start,
    step,
    again,
    el("div.speed", el("label", { for: "speed", text: "Speed" }), speed, speedText),
  );
  const strip = el("div");
  const counter = el("span.counter", { id: "step-counter" });
  const ghost = el("input", {
    type: "checkbox",
    id: "show-ghost",
    checked: true,
    "aria-label": "Ghost on the best flight",
  });
  const ghostSwitch = el(
    "label.switch",
    { id: "ghost-switch", title: "The best flight as a ghost (G)", hidden: true },
    ghost,
    el("span", { text: "Best flight" }),
  );
  root.append(strip, el("div.controls-row", bar, el("div.where", ghostSwitch, counter)));
  const timeline = mountTimeline(strip, context, {
    label: "Step of the flight that is shown",
    seek: (k) => fleet.active.forEach((player) => player.seek(k)),
  });

  function update() {
    const { playing, over } = fleet;
    const words = over ? "Fly again" : playing ? "Pause" : context.player.frames.length > 1 ? "Go on" : "Start";
    start.replaceChildren(icon(playing ? PAUSE : PLAY), el("span", { text: words }));
    start.title = over ? "Same map again (Space)" : `${words} (Space)`;
    start.hidden = !fleet.automatic && !over;
    step.hidden = !fleet.automatic;
    const away = context.live.state !== "open" || !fleet.active.length;
    start.disabled = away;
    step.disabled = away || playing || over;
    speed.value = String(Math.max(0, SPEEDS.indexOf(fleet.speed)));
    speed.setAttribute("aria-valuetext", `${fleet.speed} steps per second`);
    setText(speedText, `${fleet.speed}/s`);
    speed.parentElement.hidden = !fleet.automatic;
  }

  let words = "";
  function progress() {
    timeline.refresh();
    const shown = Math.max(0, ...fleet.active.map((player) => player.cursor));
    const most = context.player.mission?.max_steps ?? 0;
    const behind = fleet.active.some((player) => !player.following);
    setText(counter, most ? `Step ${shown} of ${most}` : "");
    counter.classList.toggle("behind", behind);
    counter.title = behind ? "Looking back: End follows the flight again" : "";
    const state = `${fleet.over}${context.player.frames.length > 1}`;
    if (state !== words) update();
    words = state;
  }

  for (const player of context.players) player.on("change", () => nextFrame(progress));
  fleet.on("playing", update);
  context.live.on("state", update);
  fleet.on("setup", update);
  context.on("missions", (players) => {
    timeline.show(players);
    update();
    progress();
  });
  update();
  return timeline;
}
