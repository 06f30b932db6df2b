// Below the map: what cells cost, what starts a race, how fingers move the map, and how to fly, until the first move.
import { TOUCH } from "./base.js";
import { el, setText } from "./dom.js";
import { mountLegend } from "./legend.js";

const FLY = TOUCH ? " Swipe on the map to fly." : " Fly with the arrow keys.";
const RACE = "Press Start (Enter) to start the race. Or just fly: then the others move when you move.";
const FINGERS = " Two fingers move and zoom the map.";

/** @param {HTMLElement} root @param {Context} context @param {Race} race */
export function mountHint(root, context, race) {
  const { stage, camera } = context;
  mountLegend(root, context);
  const what = root.appendChild(el("span"));
  const how = root.appendChild(el("strong"));
  function draw() {
    const waiting = race.mine?.steps === 0 && stage.goesOn && !stage.clock.playing;
    setText(what, (waiting ? RACE : "") + (TOUCH && camera.zoom > 1 && race.mine ? FINGERS : ""));
    setText(how, race.shown && race.human >= 0 ? FLY : "");
    // It keeps its place: the map does not move at the first step.
    how.classList.toggle("gone", race.mine?.steps !== 0);
  }
  stage.on("change", draw);
  context.on("camera", draw);
}
