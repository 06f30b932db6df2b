// What a visitor can do in Fly, by button or key.
import { ask } from "./dom.js";
import { SPEEDS } from "./stage.js";

/** @typedef {ReturnType<typeof actionsOf>} Actions */

/** @param {import("./context.js").Context} context @param {import("./fleet.js").Fleet} fleet */
export function actionsOf(context, fleet) {
  const { stage } = context;
  const { clock } = stage;

  /** Does what would end the visitor's own flight, once he has said so. */
  async function givingUp(act) {
    const { own } = fleet;
    if (own && !(await ask(`Give up your flight at step ${own.steps}?`, "Give it up", "Go on flying"))) return;
    act();
  }
  /** Whether a step from here is a new one, which the server flies. */
  const goesOn = () => fleet.shown && fleet.automatic && clock.cursor === clock.newest();
  /** Other flights: what is named is new, the rest as it is shown. A flight of the past lends its map, and its pilot if it flies. */
  function start(change, how) {
    const { track, world } = stage;
    const past = world && !fleet.shown;
    const flown = past && { task: world.task.short_name, seed: world.seed, profile: world.profile };
    const pilots = past ? [track.pilot].filter((id) => fleet.flies(id, world.task)) : [];
    return givingUp(() => fleet.start(past ? fleet.asks({ pilots, ...flown, ...change }) : change, how));
  }
  const acts = {
    givingUp,
    goesOn,
    /** What Start does now, and whether something plays. @returns {[string, boolean]} */
    word() {
      if (clock.playing || (fleet.playing && fleet.shown)) return ["Pause", true];
      if (!goesOn()) return ["Play", false];
      return [clock.cursor > 0 ? "Go on" : "Start", false];
    },
    toggle() {
      if (clock.playing) clock.stop();
      else if (fleet.playing) fleet.pause();
      else if (goesOn()) fleet.play();
      else clock.play();
    },
    first: () => clock.goTo(0),
    back: () => clock.goTo(clock.cursor - 1),
    last: () => clock.goTo(clock.newest()),
    /** The next step of what was flown; at its end the pilots fly one more. */
    forward() {
      if (goesOn()) fleet.step();
      else clock.goTo(clock.cursor + 1);
    },
    undo: () => fleet.undo(),
    reset: () => start({}),
    newMap: () => start({ seed: null }),
    start,
    fork(options) {
      const { track } = stage;
      if (!track || fleet.atHand || track.frameAt(clock.cursor).done) return;
      // The next key is for the drone, not for the button that was pressed.
      document.activeElement.blur();
      givingUp(() => fleet.fork(track, Math.min(clock.cursor, track.steps), options));
    },
    faster(by) {
      const speed = SPEEDS[SPEEDS.indexOf(clock.speed) + by];
      if (speed) fleet.setSpeed(speed);
    },
    /** Shows a layer, or hides it; what a flying person asks to see, the record says. */
    flick(layer) {
      if (layer.when && !layer.when(stage)) return;
      const shown = !context.shows(layer.id);
      context.showLayer(layer.id, shown);
      if (shown && layer.asks) fleet.help();
    },
  };
  return acts;
}
