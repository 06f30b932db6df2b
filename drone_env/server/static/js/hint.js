// Below the map: what decides there, or what starts a race; how fingers move the map; how to fly, until the first move.
import { TOUCH } from "./base.js";
import { isJoined } from "./blocks.js";
import { el, setText } from "./dom.js";

const FLY = TOUCH ? " Swipe on the map to fly." : " Fly with the arrow keys.";
const RACE = "Press Start (Enter) to start the race. Or just fly: then the others move when you move.";
const FINGERS = " Two fingers move and zoom the map.";

/** @param {HTMLElement} root @param {Context} context @param {Race} race */
export function mountHint(root, context, race) {
  const { stage, camera } = context;
  const what = root.appendChild(el("span"));
  const how = root.appendChild(el("strong"));
  function draw() {
    const waiting = race.mine?.steps === 0 && race.automatic && !race.playing;
    const fingers = TOUCH && camera.zoom > 1 && race.mine ? FINGERS : "";
    setText(what, (waiting ? RACE : stage.world ? rule(stage.world) : "") + fingers);
    setText(how, race.shown && race.human >= 0 ? FLY : "");
    // It keeps its place: the map does not move at the first step.
    how.classList.toggle("gone", race.mine?.steps !== 0);
  }
  stage.on("change", draw);
  context.on("camera", draw);
}

/** The decisive rule of a map. @param {World} world */
function rule(world) {
  const { drain, charge_rate: charge, pads, battery_capacity: capacity } = world.task;
  const costly = Object.entries(drain).filter(([, units]) => units > 1);
  const costs = costly.map(([kind, units]) => `, ${units} above a ${kind}`).join("");
  const wait = TOUCH ? "Wait" : "wait (Space)";
  const closed = isJoined(world) && world.task.impassable.length ? " Hatched areas are closed." : "";
  return `A step costs 1 battery unit${costs}.${closed} ${pads ? `On a blue pad, each ${wait} charges ${charge}` : `The battery holds ${capacity}`}.`;
}
