// One drone's flight over the map that is shown.

/**
 * @typedef {Object} Flown What a track is made of.
 * @property {Object} opening Who flies which map, as the server tells it.
 * @property {Object[]} frames Frame 0 is the start; then one per step.
 */
export class Track {
  /** @param {Flown} flown @param {{name: string, colour: string}} pilot @param {boolean} live Whether it may still go on. */
  constructor({ opening, frames }, { name, colour }, live = false) {
    this.opening = opening;
    this.pilot = opening.pilot;
    /** Who flew, as the record says it: a pilot, or several of them one after another. */
    this.by = opening.by;
    this.called = name;
    /** Its colour, as a custom property of the style sheet: `--pilot-3`. */
    this.colour = colour;
    this.frames = [...frames];
    /** Whether it is one of the past, not one that the server has flown for this page. */
    this.past = !live;
    this.live = live;
    /** What each move gave away, as `POST /annotate` tells it; null while that is not known. */
    this.annotation = null;
    /** The summary of the stored flight; null while it is not stored. */
    this.episode = null;
    /** The calls of a language model by step, several where an answer could not be used; null where none flew. */
    this.calls = null;
    /** The step from which it goes another way than the flight that it left; null where it is nobody's fork. */
    this.forkedAt = opening.forked_at;
    this.way = null;
  }

  /** The pilot's name; of a fork, where it begins, too: others flew the steps before. */
  get name() {
    return this.forkedAt ? `${this.called} from step ${this.forkedAt}` : this.called;
  }

  /** Whether a person asked for values while flying, which are kept back from others. */
  get asked() {
    return this.by.split(" from step ")[0].includes(" with values");
  }

  /** Whether a network says what it thinks of the moves. */
  get weighed() {
    return this.frames.some((frame) => frame.q_values);
  }

  /** The newest frame. */
  get last() {
    return this.frames.at(-1);
  }

  get done() {
    return this.last.done;
  }

  /** Steps flown. */
  get steps() {
    return this.frames.length - 1;
  }

  /** The frame at a step; its last one where it has not come so far. */
  frameAt(step) {
    return this.frames[Math.min(step, this.steps)];
  }

  /** Its actions up to a step. @returns {string[]} */
  actionsTo(step) {
    return this.frames.slice(1, step + 1).map((frame) => frame.action);
  }

  /** [x, y] at a position between two steps. */
  at(position) {
    const k = Math.min(Math.floor(position), this.steps);
    const a = this.frames[k];
    const b = this.frames[k + 1] ?? a;
    const t = Math.min(position - k, 1);
    return [a.x + (b.x - a.x) * t, a.y + (b.y - a.y) * t];
  }

  /** Where the nose points at a position: along the step that is flown, or the last one that moved. Radians, 0 is up. */
  heading(position) {
    for (let k = Math.min(Math.ceil(position), this.steps); k > 0; k--) {
      const dx = this.frames[k].x - this.frames[k - 1].x;
      const dy = this.frames[k].y - this.frames[k - 1].y;
      if (dx || dy) return Math.atan2(dx, -dy);
    }
    return 0;
  }

  /** Its way up to a step, in cells: it grows with the flight instead of being made anew. @returns {Path2D} */
  wayTo(step) {
    const end = Math.min(step, this.steps);
    if (!this.way || this.way.end > end) this.way = { path: new Path2D(), end: -1 };
    while (this.way.end < end) {
      const { x, y } = this.frames[++this.way.end];
      this.way.path.lineTo(x + 0.5, y + 0.5);
    }
    return this.way.path;
  }

  /** The best score that could still be reached at a step; null where that is not known. */
  valueAt(step) {
    return this.frames[step]?.value ?? null;
  }
}
