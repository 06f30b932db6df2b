// Below the map: what cells cost, how to fly, and the attribution of its data; and the figures of the kinds of cells.
import { TOUCH } from "./base.js";
import { el, setText } from "./dom.js";
import { drawFigure } from "./figures.js";
import { isJoined } from "./layer_city.js";

const SIDE = 24;
const OPEN_STREET_MAP = "https://www.openstreetmap.org/copyright";
const KINDS = ["road", "tree", "building", "obstacle"];
const FLY = TOUCH ? " Swipe on the map to fly." : " Fly with the arrow keys.";
const RACE = "Press Start (Enter) to start the race. Or just fly: then the others move when you move.";

/** @param {HTMLElement} root @param {Context} context @param {Race} race */
export function mountLegend(root, { stage }, race) {
  const [list, what, how] = root.children;
  const credit = el("p.credit", { hidden: true });
  document.querySelector(".boards-field").append(credit);
  stage.on("load", () => {
    const { attribution } = stage.world.task;
    list.replaceChildren(...itemsOf(stage.world));
    credit.hidden = !attribution;
    const about = attribution.includes("OpenStreetMap");
    credit.replaceChildren(about ? el("a", { href: OPEN_STREET_MAP, rel: "external", text: attribution }) : attribution);
  });
  stage.on("change", () => {
    const waits = race.mine?.steps === 0;
    setText(what, waits && stage.goesOn && !stage.clock.playing ? RACE : "");
    setText(how, race.shown && race.human >= 0 ? FLY : "");
    // It keeps its place: the map does not move at the first step.
    how.classList.toggle("gone", !waits);
  });
}

/** The numbers of a map's task: `road 1 · tree 2 · building 3 · barricade closed · pad +4 · any order`. @param {World} world */
function itemsOf(world) {
  const { drain, impassable, pads, charge_rate: charge } = world.task;
  const joined = isJoined(world);
  const item = (text, ...signs) => el("li", ...signs, text);
  const equal = !impassable.length && KINDS.every((kind) => drain[kind] === drain.road);
  const kinds = KINDS.map((kind) => {
    const swatch = joined ? el("i", { data: { kind }, "aria-hidden": "true" }) : kind === "road" ? "" : drawSign(kind);
    const name = kind === "obstacle" ? (joined ? "hatched" : "barricade") : kind;
    return item(`${name} ${impassable.includes(kind) ? "closed" : drain[kind]}`, swatch);
  });
  const costs = equal ? [item(`each step ${drain.road}`), item("buildings are scenery here")] : kinds;
  return [...costs, ...(pads ? [item(`pad +${charge}`, drawSign("pad"))] : []), item("any order", drawSign("parcel"))];
}

/** The figure of a kind of cell on a canvas of 24 by 24. */
export function drawSign(name) {
  const side = SIDE * (window.devicePixelRatio || 1);
  const canvas = el("canvas", { "aria-hidden": "true", width: side, height: side });
  drawFigure(canvas.getContext("2d"), name === "delivery" ? "parcel" : name, side / 2, side / 2, side);
  return canvas;
}
