// Around large maps and real places: whose data they show, and the whole of them, small, while they are seen from nearby.
import { drawBlocks } from "./blocks.js";
import { el, loaded } from "./dom.js";
import { cellName } from "./format.js";
import { isJoined, joined } from "./layer_city.js";
import { colourOf } from "./palette.js";

const OPEN_STREET_MAP = "https://www.openstreetmap.org/copyright";
const SIGN = 24;
/** Sides of the small map's picture, in CSS pixels. */
const SIDE = 144;
/** Maps of more cells along a side have a small one. */
const SMALL = 20;
/** CSS pixels that a cell takes at least where somebody begins to fly by hand. */
const BY_HAND = 22;
/** A pad on the small map. */
const SMALLEST_SIGN = 6;

/** How such maps are drawn. @type {Promise<void>|null} */
let ready = null;

/** Has them drawn, on whichever board. */
export function join() {
  const style = el("link", { rel: "stylesheet", href: new URL("../css/around.css", import.meta.url) });
  ready ??= loaded(style).then(() => (joined.draw = drawBlocks));
  return ready;
}

/** Mounted with the first map that it is about. @param {import("./context.js").Context} context */
export async function mount(context) {
  await join();
  const field = document.querySelector(".boards-field");
  const credit = el("p.credit", { hidden: true });
  field.append(credit);
  const small = new SmallMap(field, context);
  const legend = joinedLegend(context);
  const names = [];
  for (const kind of context.kinds) names[kind.id] = kind.name;

  function show() {
    const { world } = context.stage;
    const { attribution } = world.task;
    credit.hidden = !attribution;
    // Other data than that of OpenStreetMap have no page that we know of.
    const about = attribution.includes("OpenStreetMap");
    credit.replaceChildren(about ? el("a", { href: OPEN_STREET_MAP, rel: "external", text: attribution }) : attribution);
    legend(isJoined(world));
    small.show(world, names);
  }
  let seen = null;
  context.on("drawn", ({ world, layout }) => {
    if (world === seen) return;
    seen = world;
    if (nearEnough(context, layout.scale)) context.emit("camera");
  });
  context.stage.on("load", show);
  context.on("theme", () => small.show(context.stage.world, names));
  show();
  context.emit("terrain");
}

/** Who flies by hand begins nearby: from afar, a cell is too small to fly by. */
function nearEnough({ stage, pilots, camera }, scale) {
  const byHand = ({ live, done, pilot }) => live && !done && pilots.some((one) => one.id === pilot && !one.automatic);
  if (!stage.tracks.some(byHand)) return false;
  let moved = false;
  while (camera.whole * camera.zoom < BY_HAND * scale && camera.nearer(1)) moved = true;
  return moved;
}

/** In the legend, what buildings, trees and obstacles look like where they are joined. @returns {(shown: boolean) => void} */
function joinedLegend({ kinds }) {
  const scale = window.devicePixelRatio || 1;
  const cells = [[0]];
  const names = [];
  const signs = [];
  for (const name of ["building", "tree", "obstacle"]) {
    const entry = [...document.querySelectorAll(".legend li")].find((one) => one.textContent === cellName(name));
    if (!entry || !kinds.some((kind) => kind.name === name)) continue;
    const sign = el("canvas.joined", { "aria-hidden": "true", width: SIGN * scale, height: SIGN * scale });
    entry.prepend(sign);
    signs.push({ name, sign });
  }
  return (shown) => {
    document.querySelector(".legend").classList.toggle("of-blocks", shown);
    for (const { name, sign } of shown ? signs : []) {
      names[0] = name;
      const layout = { cell: 18 * scale, left: 3 * scale, top: 3 * scale, scale };
      drawBlocks(sign.getContext("2d"), { world: { cells, width: 1, height: 1 }, layout, names: [...names] });
    }
  };
}

/** The whole map, and what of it is in sight: a click or a drag there moves the map. */
class SmallMap {
  constructor(root, context) {
    this.context = context;
    this.canvas = el("canvas.small-map", { role: "img", hidden: true });
    this.canvas.setAttribute("aria-label", "The whole map, with what is in sight");
    this.ground = el("canvas");
    root.append(this.canvas);
    context.on("drawn", (view) => this.draw(view));
    const look = (event) => {
      if (!event.buttons) return;
      const { x, y, width, height } = this.canvas.getBoundingClientRect();
      const { world } = context.stage;
      const { camera } = context;
      const at = [((event.clientX - x) / width) * world.width, ((event.clientY - y) / height) * world.height];
      camera.pan(camera.centre[0] - at[0], camera.centre[1] - at[1]);
      context.emit("camera");
    };
    this.canvas.addEventListener("pointerdown", (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      look(event);
    });
    this.canvas.addEventListener("pointermove", look);
  }

  /** Draws what does not move. */
  show(world, names) {
    const longer = Math.max(world.width, world.height);
    this.large = longer > SMALL;
    const scale = window.devicePixelRatio || 1;
    const cell = Math.max(1, Math.round((SIDE * scale) / longer));
    const size = { width: world.width * cell, height: world.height * cell };
    for (const canvas of [this.ground, this.canvas]) Object.assign(canvas, size);
    this.canvas.style.aspectRatio = `${world.width} / ${world.height}`;
    this.layout = { cell, left: 0, top: 0, scale, labels: false };
    if (this.large) drawBlocks(this.ground.getContext("2d"), { world, layout: this.layout, names }, SMALLEST_SIGN);
  }

  /** The same with the flights, as a board shows them. */
  draw({ world, track, tracks, stage, clock, layout, size }) {
    if (track !== stage.track) return;
    this.canvas.hidden = !this.large || this.context.camera.zoom === 1;
    if (this.canvas.hidden) return;
    // It gives way to the drone.
    const [x, y] = track.at(clock.position);
    const across = (layout.left + x * layout.cell) / size.width;
    if (layout.top + y * layout.cell < size.height / 2 && Math.abs(across - 0.5) > 0.15)
      this.canvas.classList.toggle("aside", across > 0.5);
    const { cell, scale } = this.layout;
    const ctx = this.canvas.getContext("2d");
    ctx.drawImage(this.ground, 0, 0);
    const dot = ([x, y], radius, colour) => {
      ctx.fillStyle = colourOf(colour);
      ctx.beginPath();
      ctx.arc((x + 0.5) * cell, (y + 0.5) * cell, radius * scale, 0, 2 * Math.PI);
      ctx.fill();
      ctx.stroke();
    };
    ctx.lineWidth = scale;
    ctx.strokeStyle = colourOf("--ground");
    const delivered = new Set(track.frameAt(clock.cursor).delivered.map(String));
    for (const parcel of world.parcels) if (!delivered.has(String(parcel))) dot(parcel, 3.5, "--map-box");
    for (const one of tracks) dot(one.at(clock.position), one === track ? 4.5 : 3, one.colour);
    ctx.lineWidth = 2 * scale;
    ctx.strokeStyle = colourOf("--ink");
    const inSmall = (pixels) => (pixels / layout.cell) * cell;
    ctx.strokeRect(inSmall(-layout.left), inSmall(-layout.top), inSmall(size.width), inSmall(size.height));
  }
}

