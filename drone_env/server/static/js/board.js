// Draws a map on three canvases: the city, the layers of its cells, and the moving parts.
import { fit, lessMotion, nextFrame } from "./base.js";
import { el } from "./dom.js";
import { counted, title } from "./format.js";
import { LAYERS } from "./layers.js";

const SPIN = 0.03;
const PLACES = ["ground", "cells", "air"];

export class Board {
  /**
   * @param {HTMLElement} root Contains the canvases and sets their size.
   * @param {Context} context
   */
  constructor(root, context) {
    this.context = context;
    this.stage = context.stage;
    this.canvases = PLACES.map((place) => el(`canvas.map-${place}`, { "aria-hidden": "true" }));
    const [, , air] = this.canvases;
    air.removeAttribute("aria-hidden");
    air.setAttribute("role", "img");
    root.classList.add("map");
    root.replaceChildren(...this.canvases);
    this.before = 0;
    this.spin = 0;
    this.drawn = {};
    this.draw = this.draw.bind(this);
    // Resizing clears a canvas: draw before the browser shows it.
    this.size = fit(root, air, () => {
      this.drawn = {};
      this.draw(performance.now());
    });
    const anew = () => this.reload();
    const again = () => this.refresh();
    this.stage.on("load", anew);
    this.stage.on("change", again);
    context.on("layers", again);
    context.on("camera", again);
    context.on("theme", anew);
    document.fonts.ready.then(anew);
    anew();
  }

  refresh() {
    nextFrame(this.draw);
  }

  /** Also redraws the city, after a change of map, size or theme. */
  reload() {
    this.drawn = {};
    this.canvases[2].setAttribute("aria-label", this.stage.world ? describe(this.stage.world) : "No flight");
    this.refresh();
  }

  draw(now) {
    const { stage } = this;
    const { world, track, clock } = stage;
    if (!this.size.width || !this.size.height) return;
    const [ground, cells, air] = this.canvases;
    const ctx = air.getContext("2d");
    ctx.setTransform(1, 0, 0, 1, 0, 0);
    ctx.clearRect(0, 0, air.width, air.height);
    if (!world || !track) {
      for (const canvas of [ground, cells]) canvas.width = 0;
      return;
    }
    const passed = Math.min(now - this.before, 100);
    this.before = now;
    const still = lessMotion();
    const moving = clock.advance(still ? Infinity : passed) || clock.playing;
    if (moving && !still) this.spin += passed * SPIN;
    const size = { width: air.width, height: air.height, scale: this.size.scale };
    const layout = this.context.camera.layout(world, size, track.at(clock.position));
    const view = {
      size,
      stage,
      world,
      track,
      tracks: stage.tracks,
      clock,
      layout,
      names: this.context.names,
      spin: this.spin,
      breath: moving && !still ? 0.5 - 0.5 * Math.cos(now / 260) : 0,
    };
    const shown = LAYERS.filter((layer) => this.context.shows(layer.id));
    // Cells are drawn for the whole map; CSS moves them with the camera.
    this.drawCells(ground, view, shown, "ground", "");
    this.drawCells(cells, view, shown, "cells", `${stage.values?.what} ${stage.values?.key}`);
    cells.classList.toggle("waiting", stage.answer === null && stage.values?.what !== "range");
    for (const layer of shown) if (layer.place === "air") layer.draw(ctx, view);
    this.context.emit("drawn", view);
    if (moving && !still) this.refresh();
  }

  drawCells(canvas, view, shown, place, about) {
    const { world, layout } = view;
    const zoomed = this.context.camera.zoom > 1;
    const layers = shown.filter((layer) => layer.place === place);
    const { scale, cell } = layout;
    const own = zoomed ? { ...layout, left: 1, top: 1 } : layout;
    const key = [about, ...layers.map(({ id }) => id), cell, own.left, own.top, zoomed].join(" ");
    if (this.drawn[place] !== key) {
      this.drawn[place] = key;
      const width = zoomed ? world.width * cell + 2 : this.canvases[2].width;
      const height = zoomed ? world.height * cell + 2 : this.canvases[2].height;
      Object.assign(canvas, { width, height });
      Object.assign(canvas.style, { width: `${width / scale}px`, height: `${height / scale}px` });
      for (const layer of layers) layer.draw(canvas.getContext("2d"), { ...view, layout: own });
    }
    canvas.style.transform = zoomed
      ? `translate(${(layout.left - own.left) / scale}px, ${(layout.top - own.top) / scale}px)`
      : "";
  }
}

function describe({ task, seed, width, height, parcels }) {
  return `City map of ${title(task.short_name)}, ${width} by ${height} cells, map ${seed}, ${counted(parcels.length, "parcel")}. The list of moves describes each step.`;
}
