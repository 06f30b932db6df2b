// Asks the server what can still be reached from the moment that is shown, where a layer shows it or a flight is a fork.
import { ApiError } from "./api.js";
import { toast } from "./dom.js";
import { LAYERS, ofValues } from "./layers.js";

const KEPT = 60;
/** Milliseconds that a moment is looked at before it is asked about. */
const LOOK = 120;

/** @param {import("./context.js").Context} context */
export function mountMapValues(context) {
  const { stage, api } = context;
  const kept = new Map();
  let timer = 0;
  const asked = new Set();

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
    const { world, track, clock } = stage;
    const actions = track.actionsTo(clock.cursor);
    const key = stage.moment;
    if (key === stage.values?.key || asked.has(key)) return;
    if (kept.has(key)) show({ key, answer: kept.get(key) });
    else {
      clearTimeout(timer);
      timer = setTimeout(() => ask(key, { task: world.task.id, seed: world.seed, actions }), LOOK);
    }
  }

  async function ask(key, flight) {
    asked.add(key);
    let answer = null;
    try {
      const [told, drawing] = await Promise.all([api.post("values", flight), import("./layer_values.js")]);
      answer = told;
      Object.assign(ofValues, drawing);
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      toast(error.message);
    } finally {
      asked.delete(key);
    }
    // What was refused is not asked again.
    if (kept.size === KEPT) kept.delete(kept.keys().next().value);
    kept.set(key, answer);
    look();
  }

  function show(values) {
    clearTimeout(timer);
    stage.values = values;
    stage.tell("frames");
  }

  stage.on("change", look);
  context.on("layers", look);
}
