// The state of Fly: a map, its flights, a common clock and the selected flight.
import { Emitter, nextFrame } from "./base.js";

/** @param {Answer<"FlightHeader">} opening @param {Answer<"TaskInfo">[]} tasks @returns {World} */
export function worldOf(opening, tasks) {
  const task = tasks.find(({ id }) => id === opening.task);
  const { width, height, max_steps, battery_capacity } = task;
  return { ...opening, width, height, max_steps, battery_capacity, task };
}

/** Steps a second that can be chosen. */
export const SPEEDS = [0.5, 1, 2, 4, 6, 10, 15, 30, 60];
/** If the picture is more steps behind, it jumps instead of gliding. */
const LEAP = 4;
/** Milliseconds between two looks for a flight that the server still computes. */
const LOOK = 50;

/** `cursor` is the step that is shown; `position` follows it smoothly and is what is drawn between two steps. */
export class Clock {
  /** @param {Stage} stage */
  constructor(stage) {
    this.stage = stage;
    this.cursor = this.position = 0;
    this.playing = false;
    this.speed = 6;
    this.timer = 0;
  }

  /** The last step of all flights. */
  end() {
    return last(this.stage.tracks);
  }

  /** The newest step of the flights that may go on. */
  newest() {
    return last(this.stage.followed);
  }

  moved() {
    this.stage.tell("cursor");
  }

  /** Whether nothing newer has been flown. */
  get following() {
    return this.cursor === this.newest();
  }

  seek(step) {
    this.cursor = Math.max(0, Math.min(this.end(), Math.round(step)));
    this.moved();
  }

  goTo(step) {
    this.stop();
    this.seek(step);
  }

  /** Plays: the pilots fly on; flights that have ended are replayed, at their end from the start. */
  play() {
    if (this.playing || !(this.end() || this.stage.goesOn)) return;
    const again = this.cursor === this.end() && !this.stage.goesOn;
    if (again) this.seek(0);
    this.playing = true;
    this.tick(again ? 1000 / this.speed : 0);
    this.moved();
  }

  tick(wait = 1000 / this.speed) {
    this.timer = setTimeout(() => {
      // The pilots wait for each other.
      const waits = this.stage.followed.some(({ coming }) => coming);
      if (!waits) this.forward();
      if (this.stage.goesOn || this.cursor < this.end()) this.tick(waits ? LOOK : undefined);
      else this.stop();
    }, wait);
  }

  /** Goes to the next step; after the newest one, the pilots fly it. */
  forward() {
    const { cursor, stage } = this;
    if (stage.goesOn && (this.following || cursor === this.end())) stage.flyOn();
    else this.seek(cursor + 1);
  }

  setSpeed(speed) {
    this.speed = speed;
    this.moved();
  }

  stop() {
    clearTimeout(this.timer);
    if (!this.playing) return;
    this.playing = false;
    this.moved();
  }

  /** Moves `position` towards the cursor. @returns {boolean} Whether it has not arrived. */
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
 * Events, each followed by "change", at most once per animation frame: "load" other flights, "frames" new frames or
 * values, "cursor" another moment, or a replay starts or stops, "selected" another flight.
 */
export class Stage extends Emitter {
  constructor() {
    super();
    /** @type {World|null} */
    this.world = null;
    /** @type {Track[]} */
    this.tracks = [];
    /** The live flights. @type {Track[]} */
    this.followed = [];
    this.selected = 0;
    this.clock = new Clock(this);
    /** The newest answer of `POST /values` for this flight, with its moment; null without one. */
    this.values = null;
  }

  get track() {
    return this.tracks[this.selected] ?? null;
  }

  get frame() {
    return this.track?.frameAt(this.clock.cursor) ?? null;
  }

  /** The actions before the present step; at the end of a flight, where no move is left, those before its last step. */
  get actions() {
    const { track, clock } = this;
    return track.actionsTo(Math.min(clock.cursor, track.done ? track.steps - 1 : track.steps));
  }

  /** A key of the present moment: the map and the actions. */
  get moment() {
    const { world } = this;
    return `${world.task.id} ${world.seed} ${this.actions.join("")}`;
  }

  /** The answer of `POST /values` for this moment, or null; `values` may still belong to the moment before. */
  get answer() {
    return this.values && this.values.key === this.moment ? this.values.answer : null;
  }

  get over() {
    return this.tracks.length > 0 && this.tracks.every((track) => track.done);
  }

  /** Whether a pilot has yet to fly. */
  get goesOn() {
    return this.followed.some(({ goesOn }) => goesOn);
  }

  /** Every pilot whose flight goes on flies one step, which is shown. */
  flyOn() {
    for (const track of this.followed) track.flyOn();
    this.tell("frames");
    this.clock.seek(this.clock.newest());
  }

  show(world, tracks, { step = 0, selected = 0, followed = tracks } = {}) {
    this.world = world;
    this.tracks = tracks;
    this.followed = followed;
    this.selected = selected;
    this.values = null;
    this.clock.goTo(step);
    // At once, without gliding there.
    this.clock.position = this.clock.cursor;
    this.tell("load");
  }

  select(i) {
    if (i === this.selected || !this.tracks[i]) return;
    this.selected = i;
    this.values = null;
    this.tell("selected");
  }

  changed(track) {
    if (this.tracks.includes(track)) this.tell("frames");
  }

  tell(type) {
    this.emit(type);
    nextFrame(this.told);
  }

  told = () => this.emit("change");
}

const last = (tracks) => Math.max(0, ...tracks.map((track) => track.steps));
