// One time for all flights over a map.

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
