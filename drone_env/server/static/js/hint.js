// One sentence below the map: what decides there, or what starts a race; and how fingers move the map.
import { TOUCH } from "./base.js";
import { setText } from "./dom.js";

const RACE = "Press Start (Enter) to start the race. Or just fly: then the others move when you move.";
const FINGERS = " A swipe flies; two fingers move and zoom the map.";

/** @param {HTMLElement} root @param {Context} context @param {Fleet} fleet */
export function mountHint(root, context, fleet) {
  const { stage, camera } = context;
  const fingers = () => (TOUCH && camera.zoom > 1 && fleet.mine ? FINGERS : "");
  const draw = () =>
    setText(root, stage.world ? (atRace(fleet) ? RACE : rule(stage.world.task)) + fingers() : "");
  stage.on("change", draw);
  context.on("camera", draw);
  fleet.on("playing", draw);
}

const atRace = (fleet) => fleet.mine !== null && fleet.automatic && !fleet.playing && fleet.mine.steps === 0;

/** The decisive rule of a task. */
function rule({ drain, charge_rate: charge, pads, battery_capacity: capacity }) {
  const costly = Object.entries(drain).filter(([, units]) => units > 1);
  const costs = costly.map(([kind, units]) => `, ${units} above a ${kind}`).join("");
  const wait = TOUCH ? "Wait" : "wait (Space)";
  return `A step costs 1 battery unit${costs}. ${pads ? `On a blue pad, each ${wait} charges ${charge}` : `The battery holds ${capacity}`}.`;
}
