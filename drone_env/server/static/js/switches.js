// The switches of the layers that lie on the map.
import { el } from "./dom.js";
import { LAYERS } from "./layers.js";

/** @param {HTMLElement} root @param {import("./context.js").Context} context @param {import("./actions.js").Actions} acts */
export function mountSwitches(root, context, acts) {
  const { stage } = context;
  const rows = LAYERS.filter(({ name }) => name).map((layer) => {
    const box = el("input", { type: "checkbox", id: `layer-${layer.id}`, on: { change: () => acts.flick(layer) } });
    const key = el("kbd", { text: layer.key.toUpperCase(), "aria-hidden": "true" });
    return { layer, box, node: el("label.switch", { title: layer.hint }, box, el("span", { text: layer.name }), key) };
  });
  const unsolved = el("p.note", { id: "unsolved", role: "status" });
  const choose = () => {
    stage.pad = Number(pad.value);
    stage.tell("frames");
  };
  const pad = el("select", { id: "pad", on: { change: choose } });
  const range = el(
    "label.note",
    { id: "range-note" },
    "The numbers are the units of battery left there, flying from ",
    pad,
  );
  root.append(el("h2.eyebrow", { text: "On the map" }), ...rows.map(({ node }) => node), range, unsolved);
  let listed = "";

  function draw() {
    root.hidden = !stage.world;
    for (const { layer, box, node } of rows) {
      node.hidden = layer.when ? !layer.when(stage) : false;
      box.checked = context.shows(layer.id);
    }
    const pads = (context.shows("range") && stage.values?.answer?.pads) || [];
    range.hidden = !pads.length;
    const places = pads.map(({ position }) => `the pad at [${position.join(", ")}], charged in full`);
    if (pads.length && listed !== String(places)) {
      listed = String(places);
      pad.replaceChildren(...["here", ...places].map((text, i) => el("option", { value: i - 1, text })));
    }
    pad.value = stage.pad;
    unsolved.textContent = stage.values?.answer?.unsolved ?? "";
  }

  stage.on("change", draw);
  context.on("layers", draw);
  draw();
}
