// The layers of the map: their switches, and the answers of `POST /values` for the present moment.
import { tried } from "./api.js";
import { el, setText } from "./dom.js";
import { points } from "./format.js";
import { spanOf } from "./layer_values.js";
import { LAYERS } from "./layers.js";
import { mountPictures } from "./picture.js";
import { mountTextMap } from "./text_map.js";

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
    const values = LAYERS.some(({ id, needsValues }) => needsValues && context.shows(id));
    if (track.provenance.values_used || track.forkedAt !== null || range || values) return "values";
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
    const { world, track, actions, moment: key } = stage;
    const flight = { task: world.task.id, seed: world.seed, actions, only: what === "values" ? null : what };
    asking = true;
    const answer = await tried(() => api.post("values", flight)).finally(() => (asking = false));
    // A rejected request is not repeated.
    if (cached.size === KEPT) cached.delete(cached.keys().next().value);
    cached.set(`${what} ${key}`, answer);
    if (answer && wanted() === what && stage.track === track && !stage.answer) show({ key, what, answer });
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
  const rows = LAYERS.filter(({ name }) => name).map((layer) => {
    const box = el("input", { type: "checkbox", id: `layer-${layer.id}`, on: { change: () => acts.flick(layer) } });
    const key = el("kbd", { text: layer.key.toUpperCase(), "aria-hidden": "true" });
    return { layer, box, node: el("label.switch", { title: layer.hint }, box, el("span", { text: layer.name }), key) };
  });
  const note = el("p.note", { id: "unsolved", role: "status" });
  const scale = el("p.scale", el("span"), el("i", { "aria-hidden": "true" }), el("span"));
  root.append(el("h2.eyebrow", { text: "On the map" }), ...rows.map(({ node }) => node), note);
  rows[0].node.after(scale);
  mountTextMap(root, context);
  mountPictures(root, context);

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
      setText(scale.firstChild, `best cell ${points(most)}`);
      setText(scale.lastChild, `worst ${points(least)}`);
    }
    setText(note, unsolved ?? "");
  }

  stage.on("change", draw);
  context.on("layers", draw);
}
