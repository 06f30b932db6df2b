// The visible part of the map and its zoom.

const LABEL_ROOM = 22;
const LABELS_FROM = 20;
/** Free cells around the grid, for the rotors. */
const EDGE = 0.4;
/** From the middle of a small drone to the end of its rotors, in CSS pixels. */
const ROTORS = 13;
const ZOOMS = [1, 1.5, 2, 3, 4, 6];
/** The maximum width of a map in device pixels. */
const WIDEST = 4096;
/** The share of the window in which the drone moves without moving the map. */
const CALM = 0.3;

export class Camera {
  constructor() {
    this.reset();
  }

  /** The whole map. */
  reset() {
    this.zoom = 1;
    /** The cell in the middle of the window, unless the camera follows the drone. */
    this.centre = null;
    this.following = true;
  }

  get nearest() {
    return this.zoom === ZOOMS.at(-1) || this.zoom * this.whole >= this.most;
  }

  /** Zooms one step in or out. @returns {boolean} Whether the zoom changed. */
  nearer(by) {
    const next = ZOOMS[ZOOMS.indexOf(this.zoom) + by];
    if (!next || (by > 0 && this.nearest)) return false;
    this.zoom = next;
    if (next === 1) this.reset();
    return true;
  }

  /** Moves the map by cells and stops following the drone. */
  pan(dx, dy) {
    if (this.zoom === 1 || !this.centre) return;
    this.centre = [this.centre[0] - dx, this.centre[1] - dy];
    this.following = false;
  }

  /** @param {World} world @param {{width: number, height: number, scale: number}} size Device pixels. @param {number[]} at [x, y] of the drone. @returns {Layout} */
  layout(world, size, at) {
    const whole = fitted(world, size);
    this.whole = whole.cell;
    this.most = Math.floor(WIDEST / Math.max(world.width, world.height));
    if (this.zoom === 1) return whole;
    const cell = Math.max(whole.cell, Math.min(Math.floor(whole.cell * this.zoom), this.most));
    this.cell = cell / size.scale;
    const edge = Math.max(EDGE, ROTORS / this.cell - 0.5);
    const middle = [at[0] + 0.5, at[1] + 0.5];
    this.centre ??= middle;
    const along = (axis, cells, room) => {
      if (this.following) {
        const calm = (room / cell) * CALM;
        this.centre[axis] = within(this.centre[axis], middle[axis] - calm, middle[axis] + calm);
      }
      const half = room / cell / 2;
      this.centre[axis] = cells <= 2 * half ? cells / 2 : within(this.centre[axis], half - edge, cells - half + edge);
      return Math.round(room / 2 - this.centre[axis] * cell);
    };
    this.centre = [...this.centre];
    const left = along(0, world.width, size.width);
    const top = along(1, world.height, size.height);
    return { cell, left, top, scale: size.scale, labels: false };
  }
}

const within = (value, least, most) => Math.max(least, Math.min(most, value));

/** The whole map, centred, with whole device pixels per cell for sharp lines. */
export function fitted(world, { width, height, scale }) {
  const place = (room) =>
    Math.floor(Math.min((width - room) / (world.width + EDGE), (height - room) / (world.height + EDGE)));
  const room = LABEL_ROOM * scale;
  const labels = place(room + 2) >= LABELS_FROM * scale;
  const cell = Math.max(1, place(labels ? room + 2 : 2));
  const before = labels ? room : 0;
  return {
    cell,
    scale,
    labels,
    left: Math.floor((width - world.width * cell - before) / 2 + before),
    top: Math.floor((height - world.height * cell - before) / 2 + before),
  };
}
