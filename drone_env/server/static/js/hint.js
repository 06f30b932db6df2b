// One sentence below the map: what decides there, or what starts a race.
import { setText } from "./dom.js";

/** What waits: a key, or a button of the pad. */
const WAIT = matchMedia("(pointer: coarse)").matches ? "■" : "Space";
const RACE = "Press Start (Enter) to start the race. Or just fly: then the others move when you move.";

/** @param {HTMLElement} root @param {Context} context @param {Fleet} fleet */
export function mountHint(root, { stage }, fleet) {
  const draw = () => setText(root, stage.world ? (atRace(fleet) ? RACE : rule(stage.world.task)) : "");
  stage.on("change", draw);
  fleet.on("playing", draw);
  draw();
}

/** Whether a race of the visitor has not started. */
const atRace = (fleet) => fleet.mine !== null && fleet.automatic && !fleet.playing && fleet.mine.steps === 0;

/** The decisive rule of a task. */
function rule({ drain, charge_rate: charge, pads, battery_capacity: capacity }) {
  const costly = Object.entries(drain).filter(([, units]) => units > 1);
  const costs = costly.map(([kind, units]) => `, ${units} above a ${kind}`).join("");
  const ends = pads ? `On a blue pad, each wait (${WAIT}) charges ${charge}.` : `The battery holds ${capacity}.`;
  return `A step costs 1 battery unit${costs}. ${ends}`;
}
