// The map on three canvases (the city, the layers of its cells, the moving parts), with its zoom buttons and drags.
import { fit, lessMotion, nextFrame } from "./base.js";
import { el, icon } from "./dom.js";
import { counted, title } from "./format.js";
import { LAYERS } from "./layers.js";

const SPIN = 0.03;
/** The minimum size of a cell in CSS pixels when the visitor starts to fly. */
const BY_HAND = 16;
/** The share of the window over which the drone and its target may be apart. */
const SEEN = 0.75;

/** @param {HTMLElement} root @param {Context} context @returns {{refresh: () => void, reload: () => void}} */
export function mountBoard(root, context) {
  const { stage, camera } = context;
  const [ground, cells] = ["ground", "cells"].map((place) => el(`canvas.map-${place}`, { "aria-hidden": "true" }));
  const air = el("canvas.map-air", { role: "img" });
  const field = el("div.map-field.map", ground, cells, air);
  const grid = el("div.boards", { id: "boards" }, field);
  root.append(el("div.boards-field", grid, toolsOf(context)));
  let before = 0;
  let spin = 0;
  let seen = null;
  /** What the ground and the cells show. */
  let drawn = {};
  // Resizing clears a canvas: draw before the browser shows it.
  const measured = fit(field, air, () => {
    drawn = {};
    draw(performance.now());
  });
  const refresh = () => nextFrame(draw);

  /** Also redraws the city, after a change of map, size or theme. */
  function reload() {
    drawn = {};
    air.setAttribute("aria-label", stage.world ? describe(stage.world) : "No flight");
    refresh();
  }

  function draw(now) {
    const { world, track, clock } = stage;
    if (!measured.width || !measured.height) return;
    const ctx = air.getContext("2d");
    ctx.setTransform(1, 0, 0, 1, 0, 0);
    ctx.clearRect(0, 0, air.width, air.height);
    if (!world || !track) {
      ground.width = cells.width = 0;
      return;
    }
    const passed = Math.min(now - before, 100);
    before = now;
    const still = lessMotion();
    const moving = (clock.advance(still ? Infinity : passed) || clock.playing) && !still;
    if (moving) spin += passed * SPIN;
    const size = { width: air.width, height: air.height, scale: measured.scale };
    const layout = camera.layout(world, size, track.at(clock.position));
    const view = { size, stage, world, track, tracks: stage.tracks, clock, layout, names: context.names, spin };
    const shown = LAYERS.filter((layer) => context.shows(layer.id));
    // Cells are drawn for the whole map; CSS moves them with the camera.
    drawCells(ground, view, shown, "ground", "");
    drawCells(cells, view, shown, "cells", `${stage.values?.what} ${stage.values?.key}`);
    cells.classList.toggle("waiting", stage.answer === null && stage.values?.what !== "range");
    for (const layer of shown) if (layer.place === "air") layer.draw(ctx, view);
    if (world !== seen) {
      seen = world;
      lookAtTarget(context, view);
      context.emit("camera");
    }
    context.emit("drawn", view);
    if (moving) refresh();
  }

  function drawCells(canvas, view, shown, place, about) {
    const { world, layout } = view;
    const zoomed = camera.zoom > 1;
    const layers = shown.filter((layer) => layer.place === place);
    const { scale, cell } = layout;
    const own = zoomed ? { ...layout, left: 1, top: 1 } : layout;
    const key = [about, ...layers.map(({ id }) => id), cell, own.left, own.top, zoomed].join(" ");
    if (drawn[place] !== key) {
      drawn[place] = key;
      const width = zoomed ? world.width * cell + 2 : air.width;
      const height = zoomed ? world.height * cell + 2 : air.height;
      Object.assign(canvas, { width, height });
      Object.assign(canvas.style, { width: `${width / scale}px`, height: `${height / scale}px` });
      for (const layer of layers) layer.draw(canvas.getContext("2d"), { ...view, layout: own });
    }
    canvas.style.translate = `${(layout.left - own.left) / scale}px ${(layout.top - own.top) / scale}px`;
  }

  stage.on("load", () => {
    camera.reset();
    reload();
  });
  stage.on("change", refresh);
  for (const event of ["layers", "camera"]) context.on(event, refresh);
  context.on("camera", () => grid.classList.toggle("near", camera.zoom > 1));
  context.on("theme", reload);
  document.fonts.ready.then(reload);
  reload();
  listenToDrags(grid, context);
  return { refresh, reload };
}

/** The buttons of the camera. @param {Context} context */
function toolsOf(context) {
  const { stage, camera } = context;
  const tool = (label, d, act) =>
    el("button.icon-button", { "aria-label": label, title: label, press: () => context.emit("camera", act()) }, icon(d));
  const farther = tool("Zoom out", "M6 12h12", () => camera.nearer(-1));
  const nearer = tool("Zoom in", "M12 6v12M6 12h12", () => camera.nearer(1));
  const around = "M12 4v3M12 17v3M4 12h3M17 12h3M8 12a4 4 0 1 0 8 0a4 4 0 1 0-8 0";
  const follow = tool("Follow the drone", around, () => (camera.following = true));
  function update() {
    nearer.disabled = camera.nearest;
    farther.disabled = follow.disabled = camera.zoom === 1;
    follow.hidden = camera.following || camera.zoom === 1;
  }
  stage.on("change", update);
  context.on("camera", update);
  return el("div.map-tools", { role: "group", "aria-label": "Map" }, nearer, farther, follow);
}

function describe({ task, seed, width, height, parcels }) {
  return `City map of ${title(task.short_name)}, ${width} by ${height} cells, map ${seed}, ${counted(parcels.length, "parcel")}. The list of moves describes each step.`;
}

/** Zooms in until the cells are large enough for a visitor who flies, while drone and target are in view. */
function lookAtTarget({ stage, camera }, { size, track, layout }) {
  if (!stage.tracks.some((one) => one.byHand)) return;
  const { x, y, target } = track.last;
  const [tx, ty] = target ?? [x, y];
  const apart = Math.max(Math.abs(tx - x) / size.width, Math.abs(ty - y) / size.height);
  const cell = () => camera.whole * camera.zoom;
  while (cell() < BY_HAND * layout.scale && camera.nearer(1));
  while (cell() * apart > SEEN && camera.nearer(-1));
  if (camera.zoom > 1) camera.centre = [(x + tx + 1) / 2, (y + ty + 1) / 2];
}

/** A drag moves a map that is larger than its window. @param {Context} context */
function listenToDrags(grid, context) {
  const { camera, stage } = context;
  let from = null;
  grid.addEventListener("pointerdown", (event) => (from = event));
  for (const type of ["pointerup", "pointercancel", "pointerleave"]) grid.addEventListener(type, () => (from = null));
  grid.addEventListener("pointermove", (event) => {
    // If the visitor flies, a swipe flies.
    const swipes = event.pointerType !== "mouse" && document.body.classList.contains("human-flies");
    if (!from || !stage.world || swipes) return;
    camera.pan((event.clientX - from.clientX) / camera.cell, (event.clientY - from.clientY) / camera.cell);
    from = event;
    context.emit("camera");
  });
}
