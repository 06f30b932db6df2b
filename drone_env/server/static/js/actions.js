// The actions of Fly, for buttons and keys.
import { ask, leaveFocus, toast } from "./dom.js";
import { variants } from "./format.js";

/** @param {Context} context @param {Race} race */
export function actionsOf(context, race) {
  const { stage } = context;
  const { clock } = stage;

  async function givingUp(act, yes = "Give up") {
    const { begun } = race;
    const question = yes === "Give up" ? yes : `${yes}, and give up`;
    if (begun && !(await ask(`${question} your flight at step ${begun.flown}?`, yes, "Keep flying"))) return;
    act();
  }
  /** Starts other flights. Missing parts come from the flights that are shown, also from a stored one. */
  function start(change, how, yes) {
    const { track, world } = stage;
    const pilots = track ? [track.pilot].filter((id) => race.flies(id, world.task)) : [];
    const past = world && !race.shown && { task: world.task.short_name, seed: world.seed, profile: world.reward_profile, pilots };
    return givingUp(() => race.start({ ...past, ...change }, how), yes);
  }
  return {
    toggle: () => (clock.playing ? clock.stop() : clock.play()),
    first: () => clock.goTo(0),
    back: () => clock.goTo(clock.cursor - 1),
    last: () => clock.goTo(clock.newest()),
    forward() {
      clock.stop();
      clock.forward();
    },
    undo: () => race.fly("UNDO"),
    /** Starts over, beside the same ghost if there is one. */
    reset: () => start({ ghost: race.setup.ghost }, { beside: race.setup.ghost ? race.newest.beside : [] }, "Start over"),
    newMap: () => variants(stage.world?.task) && start({ seed: null }),
    start,
    /** Leaves the selected flight at the present step, by this action if there is one. */
    fork(action = null) {
      const { track } = stage;
      if (!track || race.atHand || track.frameAt(clock.cursor).done) return;
      // The next key is for the drone, not for the pressed button.
      leaveFocus();
      givingUp(() => race.fork(track, Math.min(clock.cursor, track.steps), action));
    },
    /** Shows or hides a layer. If the visitor flies, the record notes that values were shown. */
    flick(layer) {
      if (layer.when && !layer.when(stage)) {
        toast(`${layer.name} cannot be shown here now.`);
        return;
      }
      const shown = !context.shows(layer.id);
      context.showLayer(layer.id, shown);
      if (shown && layer.needsValues) race.help();
    },
  };
}
