// One flight on the page: its map, its frames, and where in them we look.
import { Emitter } from "./emitter.js";

/**
 * `cursor` is the frame that is shown; `position` follows it smoothly and is what the map draws between two frames.
 * A live flight pushes frames and follows its end; a replay plays by itself.
 *
 * `playing` says that a replay runs, `flying` that a live flight does.
 *
 * Events, each followed by "change": "load" another flight, "frames" more frames or values, "cursor" another frame is
 * shown, "play" the replay was started or stopped.
 */
export class Player extends Emitter {
  constructor() {
    super();
    this.mission = null;
    this.frames = [];
    this.cursor = 0;
    this.position = 0;
    this.following = true;
    this.playing = false;
    this.flying = false;
    this.speed = 6;
    this.timer = 0;
    this.annotation = null;
  }

  /** The frame that is shown. */
  get frame() {
    return this.frames[this.cursor] ?? null;
  }

  /** The newest frame. */
  get last() {
    return this.frames.at(-1) ?? null;
  }

  get empty() {
    return this.mission === null;
  }

  /** Shows another flight, from its end if it is live, else from its start. */
  load(mission, frames, { atEnd = false } = {}) {
    this.stop();
    this.mission = mission;
    this.frames = [...frames];
    this.annotation = null;
    this.following = true;
    this.cursor = this.position = atEnd ? this.frames.length - 1 : 0;
    this.tell("load");
    this.tell("cursor");
  }

  /** Shows nothing. */
  clear() {
    this.stop();
    this.mission = this.annotation = null;
    this.frames = [];
    this.cursor = this.position = 0;
    this.tell("load");
  }

  /** Adds the next frame of a live flight. */
  push(frame) {
    this.frames.push(frame);
    this.tell("frames");
    if (this.following) {
      this.cursor = this.frames.length - 1;
      this.tell("cursor");
    }
  }

  /** Values that came after their frames: the best score that could still be reached from each, and what had been given away. */
  setValues(values, regrets) {
    values.forEach((value, i) => {
      if (this.frames[i]) Object.assign(this.frames[i], { value, regret: regrets[i] });
    });
    this.tell("frames");
  }

  /** What each move gave away; null for nothing. */
  annotate(annotation) {
    this.annotation = annotation;
    this.tell("frames");
  }

  /** Shows frame k. A live flight is followed again from its last frame on. */
  seek(k) {
    if (!this.frames.length) return;
    this.cursor = Math.max(0, Math.min(this.frames.length - 1, Math.round(k)));
    this.following = this.cursor === this.frames.length - 1;
    this.tell("cursor");
  }

  /** Plays the frames there are, from the start if we are at the end. */
  play() {
    if (this.playing || this.frames.length < 2) return;
    if (this.cursor === this.frames.length - 1) this.seek(0);
    this.playing = true;
    this.tick();
    this.tell("play");
  }

  tick() {
    this.timer = setTimeout(() => {
      this.seek(this.cursor + 1);
      if (this.cursor < this.frames.length - 1) this.tick();
      else this.stop();
    }, 1000 / this.speed);
  }

  /** Stops the replay where it is. */
  stop() {
    clearTimeout(this.timer);
    if (!this.playing) return;
    this.playing = false;
    this.tell("play");
  }

  /** Moves `position` towards the cursor for a drawing; true while there is more to come. */
  advance(milliseconds) {
    const gap = this.cursor - this.position;
    if (gap === 0) return false;
    if (Math.abs(gap) > 4) {
      this.position = this.cursor;
      return false;
    }
    const lengthOfStep = Math.min(1000 / this.speed, 400);
    const stride = (milliseconds / lengthOfStep) * Math.max(1, Math.abs(gap));
    this.position = Math.abs(gap) <= stride ? this.cursor : this.position + Math.sign(gap) * stride;
    return this.position !== this.cursor;
  }

  tell(type) {
    this.emit(type);
    if (type !== "change") this.emit("change");
  }
}
