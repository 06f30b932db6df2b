// What is shown in Fly: a map, the flights over it, the moment on a clock for all of them, and which is looked at.
import { Emitter, nextFrame } from "./base.js";

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

/** Steps a second that can be chosen. */
export const SPEEDS = [0.5, 1, 2, 4, 6, 10, 15, 30, 60];
/** So far behind, in steps, the picture jumps instead of gliding. */
const LEAP = 4;

/** `cursor` is the step that is shown; `position` follows it smoothly and is what is drawn between two steps. */
export class Clock {
  /**
   * @param {() => number} end The last step there is. @param {() => number} newest The one that was flown last: a flight that
   *   goes on may lie beside one that is longer. @param {() => void} moved Called when another step is shown, or it is played
   *   or stopped.
   */
  constructor(end, newest, moved) {
    this.end = end;
    this.newest = newest;
    this.moved = moved;
    this.cursor = this.position = 0;
    /** Whether new steps are shown as they come. */
    this.following = true;
    /** Whether what has been flown is played by itself. */
    this.playing = false;
    this.speed = 6;
    this.timer = 0;
  }

  /** Shows a step at once. */
  jump(step) {
    this.stop();
    this.cursor = this.position = Math.max(0, Math.min(this.end(), step));
    this.following = this.cursor === this.newest();
  }

  /** Goes to a step. Live flights are followed again from the newest one on. */
  seek(step) {
    this.cursor = Math.max(0, Math.min(this.end(), Math.round(step)));
    this.following = this.cursor === this.newest();
    this.moved();
  }

  /** Goes to a step, and stays there. */
  goTo(step) {
    this.stop();
    this.seek(step);
  }

  /** Shows the newest step, unless somebody looks back. */
  follow() {
    if (this.following) this.seek(this.newest());
  }

  /** Plays what there is, from the start if we are at the end. */
  play() {
    if (this.playing || this.end() === 0) return;
    if (this.cursor === this.end()) this.seek(0);
    this.playing = true;
    this.tick();
    this.moved();
  }

  tick() {
    this.timer = setTimeout(() => {
      this.seek(this.cursor + 1);
      if (this.cursor < this.end()) this.tick();
      else this.stop();
    }, 1000 / this.speed);
  }

  stop() {
    clearTimeout(this.timer);
    if (!this.playing) return;
    this.playing = false;
    this.moved();
  }

  /** Moves `position` towards the cursor for a drawing; true while there is more to come. */
  advance(milliseconds) {
    const gap = this.cursor - this.position;
    if (gap === 0) return false;
    const lengthOfStep = Math.min(1000 / this.speed, 400);
    const stride = (milliseconds / lengthOfStep) * Math.max(1, Math.abs(gap));
    const there = Math.abs(gap) > LEAP || Math.abs(gap) <= stride;
    this.position = there ? this.cursor : this.position + Math.sign(gap) * stride;
    return this.position !== this.cursor;
  }
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
