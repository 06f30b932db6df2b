// Asks the server what can still be reached from the moment that is shown, where a layer shows it or a flight is a fork.
import { ApiError } from "./api.js";
import { toast } from "./dom.js";
import { LAYERS, ofValues } from "./layers.js";

const KEPT = 60;
/** Milliseconds until it is asked about the moment that is looked at then. */
const LOOK = 120;

/** @param {import("./context.js").Context} context */
export function mountMapValues(context) {
  const { stage, api } = context;
  const kept = new Map();
  let timer = 0;
  let asking = false;

  function wanted() {
    const { track } = stage;
    if (!track || context.secret(track)) return false;
    return track.asked || track.forkedAt !== null || LAYERS.some(({ id, asks }) => asks && context.shows(id));
  }

  function look() {
    if (!wanted()) {
      if (stage.values) show(null);
      return;
    }
    const key = stage.moment;
    if (key === stage.values?.key) return;
    if (kept.has(key)) show({ key, answer: kept.get(key) });
    else if (!asking) timer ||= setTimeout(ask, LOOK);
  }

  // One question at a time, and after it the newest: on large maps a flight would leave all answers behind.
  async function ask() {
    timer = 0;
    if (!wanted() || kept.has(stage.moment)) {
      look();
      return;
    }
    const { world, track, clock, moment: key } = stage;
    const flight = { task: world.task.id, seed: world.seed, actions: track.actionsTo(clock.cursor) };
    asking = true;
    let answer = null;
    try {
      const [told, drawing] = await Promise.all([api.post("values", flight), import("./layer_values.js")]);
      answer = told;
      Object.assign(ofValues, drawing);
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      toast(error.message);
    } finally {
      asking = false;
    }
    // What was refused is not asked again.
    if (kept.size === KEPT) kept.delete(kept.keys().next().value);
    kept.set(key, answer);
    if (answer && wanted() && stage.track === track && !stage.answer) show({ key, answer });
    look();
  }

  function show(values) {
    clearTimeout(timer);
    timer = 0;
    stage.values = values;
    stage.tell("frames");
  }

  stage.on("change", look);
  context.on("layers", look);
}
