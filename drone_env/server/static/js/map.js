// Draws one flight on two canvases, the city and what moves in it. Shared by Watch, Race and Replay.
import { el } from "./dom.js";
import { title } from "./format.js";
import { fit } from "./fitted.js";
import { lessMotion, nextFrame, noFrame } from "./loop.js";
import { drawFlight } from "./map_flight.js";
import { drawTerrain } from "./map_terrain.js";
import { lanePalette, palette } from "./palette.js";

const LABEL_ROOM = 22;
const LABELS_FROM = 20;
const SPIN = 0.03;
/** Cells left free around the grid: the rotors reach over it. */
const EDGE = 0.32;

export class CityMap {
  /**
   * @param {HTMLElement} root Filled with the canvases, which take its size; the grid is centred, its cells are square.
   * @param {import("./player.js").Player} player What is drawn: the map redraws by itself whenever the player changes.
   * @param {import("./context.js").Context} context For the kinds of cells and the theme.
   * @param {number} [lane] Which of the racers' colours it has.
   */
  constructor(root, player, context, lane = 0) {
    this.root = root;
    this.player = player;
    this.lane = lane;
    this.names = [];
    for (const kind of context.kinds) this.names[kind.id] = kind.name;
    /** Whether the network's values of the actions are shown as arrows; [x, y] of a best flight, drawn as a ghost. */
    this.shown = { values: true, ghost: null };
    this.terrain = el("canvas.map-terrain", { "aria-hidden": "true" });
    this.flight = el("canvas.map-flight", { role: "img", "aria-label": "No flight" });
    root.classList.add("map");
    root.replaceChildren(this.terrain, this.flight);
    this.layout = null;
    this.stale = true;
    this.before = 0;
    this.spin = 0;
    this.draw = this.draw.bind(this);
    // A canvas that has another size is empty: it is drawn at once, before the browser shows it.
    this.size = fit(root, [this.terrain, this.flight], () => {
      this.stale = true;
      this.draw(performance.now());
    });
    const reload = () => this.reload();
    const ends = [
      player.on("load", reload),
      player.on("change", () => this.refresh()),
      context.on("theme", reload),
      this.size.stop,
      () => noFrame(this.draw),
    ];
    this.destroy = () => ends.forEach((end) => end());
    document.fonts.ready.then(reload);
    reload();
  }

  /** Shows or hides what can be shown beside the flight: `{values: false}`, `{ghost: path}`. */
  show(change) {
    Object.assign(this.shown, change);
    this.refresh();
  }

  /** Draws again in the next animation frame. */
  refresh() {
    nextFrame(this.draw);
  }

  /** Draws the city again, too: another flight, size or theme. */
  reload() {
    this.stale = true;
    const { mission } = this.player;
    this.flight.setAttribute("aria-label", mission ? describe(mission) : "No flight");
    this.refresh();
  }

  draw(now) {
    const { player } = this;
    if (!this.size.width || !this.size.height) return;
    const colours = lanePalette(this.lane);
    if (this.stale) this.drawCity(colours);
    const ctx = this.flight.getContext("2d");
    ctx.clearRect(0, 0, this.flight.width, this.flight.height);
    if (player.empty || !player.frames.length) return;
    const passed = Math.min(now - this.before, 100);
    this.before = now;
    const still = lessMotion();
    const moving = player.advance(still ? Infinity : passed) || player.playing || player.flying;
    if (moving && !still) this.spin += passed * SPIN;
    const shown = {
      ...this.shown,
      spin: this.spin,
      breath: moving && !still ? 0.5 - 0.5 * Math.cos(now / 260) : 0,
      lift: player.frames[Math.round(player.position)].done ? 0.15 : 1,
    };
    drawFlight(ctx, player, this.layout, shown, colours);
    if (moving && !still) this.refresh();
  }

  drawCity(colours) {
    this.stale = false;
    const { width, height } = this.terrain;
    const ctx = this.terrain.getContext("2d");
    ctx.clearRect(0, 0, width, height);
    const { mission } = this.player;
    if (!mission) return;
    this.layout = layOut(mission, width, height, this.size.scale);
    drawTerrain(ctx, mission, this.layout, this.names, colours);
  }

  /** The map as it stands, as an image of its own. @returns {HTMLCanvasElement} */
  image() {
    const canvas = el("canvas", { width: this.terrain.width, height: this.terrain.height });
    const ctx = canvas.getContext("2d");
    ctx.fillStyle = palette().ground;
    ctx.fillRect(0, 0, canvas.width, canvas.height);
    ctx.drawImage(this.terrain, 0, 0);
    ctx.drawImage(this.flight, 0, 0);
    return canvas;
  }
}

/** Where the grid lies: whole device pixels per cell, so that lines are sharp. */
function layOut(mission, width, height, scale) {
  const place = (room) =>
    Math.floor(Math.min((width - room) / (mission.width + EDGE), (height - room) / (mission.height + EDGE)));
  const room = LABEL_ROOM * scale;
  const labels = place(room + 2) >= LABELS_FROM * scale;
  const cell = Math.max(1, place(labels ? room + 2 : 2));
  const before = labels ? room : 0;
  return {
    cell,
    scale,
    labels,
    left: Math.floor((width - mission.width * cell - before) / 2 + before),
    top: Math.floor((height - mission.height * cell - before) / 2 + before),
  };
}

function describe(mission) {
  const parcels = `${mission.parcels.length} ${mission.parcels.length === 1 ? "parcel" : "parcels"}`;
  return (
    `City map of ${title(mission.short_name)}, ${mission.width} by ${mission.height} cells, map ${mission.seed}, ` +
    `${parcels}. The events are listed below.`
  );
}
