// What is shown in Fly: a map, the flights over it, the moment, and which of them is looked at.
import { Clock } from "./clock.js";
import { Emitter } from "./emitter.js";
import { nextFrame } from "./loop.js";

/**
 * @typedef {Object} World The map.
 * @property {Object} task As `GET /tasks` tells it. @property {number} seed @property {string} profile
 * @property {number} width @property {number} height @property {number} maxSteps @property {number} capacity Of the battery.
 * @property {number[][]} cells Kinds of the cells at the start, [y][x]. @property {number[][]} parcels [x, y] of each.
 */

/** @returns {World} */
export function worldOf(opening, tasks) {
  return {
    task: tasks.find((task) => task.id === opening.task),
    seed: opening.seed,
    profile: opening.reward_profile,
    width: opening.width,
    height: opening.height,
    maxSteps: opening.max_steps,
    capacity: opening.battery_capacity,
    cells: opening.cells,
    parcels: opening.parcels,
  };
}

/**
 * Events, each followed by "change", at most once a frame: "load" other flights, "frames" more of one, or of what is known of
 * it, "cursor" another moment is shown or it is played or stopped, "selected" another flight is looked at.
 */
export class Stage extends Emitter {
  constructor() {
    super();
    /** @type {World|null} */
    this.world = null;
    /** @type {import("./track.js").Track[]} */
    this.tracks = [];
    /** Those of them whose newest step is shown as it comes. @type {import("./track.js").Track[]} */
    this.followed = [];
    this.selected = 0;
    this.clock = new Clock(
      () => last(this.tracks),
      () => last(this.followed),
      () => this.tell("cursor"),
    );
    /** What `POST /values` says of the moment and the flight that are looked at; null where nobody asked. */
    this.values = null;
    /** Of its pads, the one from which the battery's range is shown; -1 for the drone's place. */
    this.pad = -1;
    /** Whether a live flight is flying by itself just now. */
    this.flying = false;
  }

  /** The flight that is looked at. */
  get track() {
    return this.tracks[this.selected] ?? null;
  }

  /** Its frame at the moment that is shown. */
  get frame() {
    return this.track?.frameAt(this.clock.cursor) ?? null;
  }

  /** The moment that is looked at, in words that no other has: a map, and what was flown over it. */
  get moment() {
    const { track, world, clock } = this;
    return `${world.task.id} ${world.seed} ${track.actionsTo(clock.cursor).join("")}`;
  }

  /** What the server says of this very moment; null until it has, while `values` are of the one before. */
  get answer() {
    return this.values && this.values.key === this.moment ? this.values.answer : null;
  }

  /** Whether all flights have ended. */
  get over() {
    return this.tracks.length > 0 && this.tracks.every((track) => track.done);
  }

  /** Shows a map with flights over it. @param {number} step The moment. */
  show(world, tracks, { step = 0, selected = 0, followed = tracks } = {}) {
    this.world = world;
    this.tracks = tracks;
    this.followed = followed;
    this.selected = selected;
    this.values = null;
    this.pad = -1;
    this.clock.jump(step);
    this.tell("load");
  }

  /** Looks at another flight. */
  select(i) {
    if (i === this.selected || !this.tracks[i]) return;
    this.selected = i;
    this.values = null;
    this.tell("selected");
  }

  /** A flight has changed: it has more frames, or more is known of them. */
  changed(track) {
    if (!this.tracks.includes(track)) return;
    this.tell("frames");
    this.clock.follow();
  }

  tell(type) {
    this.emit(type);
    nextFrame(this.told);
  }

  told = () => this.emit("change");
}

const last = (tracks) => Math.max(0, ...tracks.map((track) => track.steps));
