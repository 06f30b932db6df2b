// The answers of `POST /values` for the present moment: the layers of the map, and the table of moves.
import { tried } from "./api.js";
import { el, setText } from "./dom.js";
import { fixed, isLost, points } from "./format.js";
import { spanOf } from "./layer_values.js";
import { LAYERS } from "./layers.js";

const KEPT = 60;
/** Milliseconds between a new moment and its request. */
const LOOK = 120;

/** Requests the values if a layer shows them or the flight is a fork. @param {Context} context */
export function mountMapValues(context) {
  const { stage, api } = context;
  const cached = new Map();
  let timer = 0;
  let asking = false;

  /** "range" is all that a visitor sees who flies without values, "moves" fills their table; null for nothing. */
  function wanted() {
    const { track, frame, clock } = stage;
    if (!track) return null;
    const range = context.shows("range");
    if (track.secret) return range ? "range" : null;
    if (track.provenance.values_used || track.forkedAt !== null || range || context.shows("values")) return "values";
    return frame.done || frame.value === null || clock.playing ? null : "moves";
  }

  function look() {
    const what = wanted();
    if (!what) {
      if (stage.values) show(null);
      return;
    }
    const key = stage.moment;
    if (key === stage.values?.key && what === stage.values.what) return;
    const known = cached.get(`${what} ${key}`);
    if (known !== undefined) show({ key, what, answer: known });
    else if (!asking) timer ||= setTimeout(ask, LOOK);
  }

  // One request at a time, then one for the newest moment: large maps are slow.
  async function ask() {
    timer = 0;
    const what = wanted();
    if (!what || cached.has(`${what} ${stage.moment}`)) {
      look();
      return;
    }
    const { world, actions, moment: key } = stage;
    const flight = { task: world.task.id, seed: world.seed, actions, only: what === "values" ? null : what };
    asking = true;
    const answer = await tried(() => api.post("values", flight)).finally(() => (asking = false));
    // A rejected request is not repeated.
    if (cached.size === KEPT) cached.delete(cached.keys().next().value);
    cached.set(`${what} ${key}`, answer);
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

/** The switches of the layers. @param {HTMLElement} root @param {Context} context */
export function mountSwitches(root, context, acts) {
  const { stage } = context;
  const [switches, scale, note] = root.querySelectorAll(".switches, .scale, #unsolved");
  const rows = LAYERS.filter(({ name }) => name).map((layer) => {
    const box = el("input", { type: "checkbox", id: `layer-${layer.id}`, on: { change: () => acts.flick(layer) } });
    const key = el("kbd", { text: layer.key.toUpperCase(), "aria-hidden": "true" });
    return { layer, box, node: el("label.switch", { title: layer.hint }, box, el("span", { text: layer.name }), key) };
  });
  switches.append(...rows.map(({ node }) => node));
  rows[0].node.after(scale);

  function draw() {
    root.hidden = !stage.world;
    for (const { layer, box, node } of rows) {
      node.hidden = layer.when ? !layer.when(stage) : false;
      box.checked = context.shows(layer.id);
    }
    const { cells, unsolved } = stage.values?.answer ?? {};
    scale.hidden = !cells || !context.shows("values");
    if (!scale.hidden) {
      const { most, least } = spanOf(cells.values);
      setText(scale.firstElementChild, `best cell ${points(most)}`);
      setText(scale.lastElementChild, `worst ${points(least)}`);
    }
    setText(note, unsolved ?? "");
  }

  stage.on("change", draw);
  context.on("layers", draw);
}

/** The table of the moves from here: the network's values, and the score that stays possible. @param {HTMLElement} root @param {Context} context @param {Race} race */
export function mountThinking(root, { stage }, race, acts) {
  const table = root.querySelector("table");
  const rows = [...table.tBodies[0].rows];
  const ask = root.querySelector("button");
  ask.addEventListener("click", () => race.help());
  // A move continues the visitor's own flight, or forks another one.
  for (const { dataset, cells } of rows) {
    cells[0].firstElementChild.addEventListener("click", () => (race.atHand ? race.fly(dataset.action) : acts.fork(dataset.action)));
  }

  stage.on("change", () => {
    const { track, frame, answer } = stage;
    root.hidden = !track;
    if (!track) return;
    const network = frame.q_values;
    table.classList.toggle("unweighed", !track.weighed);
    const exact = frame.done ? null : (answer?.q_values ?? null);
    for (const { dataset, cells, classList } of rows) {
      const [name, value, possible, loss] = cells;
      const lost = exact && Math.max(...Object.values(exact)) - exact[dataset.action];
      setText(value, network ? fixed(network[dataset.action], 3) : "–");
      setText(possible, exact ? points(exact[dataset.action]) : "–");
      setText(loss, exact ? (isLost(lost) ? points(lost) : "0") : "–");
      value.classList.toggle("best", network !== null && network[dataset.action] === Math.max(...Object.values(network)));
      classList.toggle("best", exact !== null && !isLost(lost));
      name.querySelector("button").disabled = frame.done;
    }
    ask.hidden = !track.secret;
  });
}
