// The model of the editor: a map, the present stroke and the undo history.
import { Emitter } from "./base.js";

const UNDONE = 100;
const same = (a, b) => a[0] === b[0] && a[1] === b[1];

/**
 * Events: "stroke" a stroke goes on, "end" a stroke has changed the map, "map" the whole map is replaced, "last" the
 * last parcel is not painted over. A cell is [x, y].
 */
export class Drawing extends Emitter {
  /** @param {Answer<"KindInfo">[]} kinds */
  constructor(kinds) {
    super();
    this.kinds = kinds;
    this.road = this.idOf("road");
    /** A kind of cell, `parcel`, `start` or `move`. */
    this.tool = "move";
    this.become(null);
  }

  /** Replaces the map: the body of `POST /maps/worth`, or null. */
  become(map) {
    this.map = map;
    this.past = [];
    /** The present stroke: the map before it, its cell, and the cell of the held item. */
    this.stroke = null;
  }

  idOf(name) {
    return this.kinds.find((kind) => kind.name === name).id;
  }

  /** @param {number[]} cell */
  inside([x, y]) {
    return this.map.cells[y]?.[x] !== undefined;
  }

  nameAt(cell) {
    if (same(this.map.start, cell)) return "start";
    return this.parcelAt(cell) >= 0 ? "parcel" : this.kinds[this.at(cell)].name;
  }

  at([x, y]) {
    return this.map.cells[y][x];
  }

  put([x, y], kind) {
    this.map.cells[y][x] = kind;
  }

  parcelAt(cell) {
    return this.map.parcels.findIndex((parcel) => same(parcel, cell));
  }

  empty(width, height) {
    return Array.from({ length: height }, () => new Array(width).fill(this.road));
  }

  /** Moves an item to a road cell. @returns {boolean} Whether it moved. */
  move(from, to) {
    const { map } = this;
    if (!this.inside(to) || this.nameAt(to) !== "road") return false;
    const parcel = this.parcelAt(from);
    if (same(map.start, from)) map.start = to;
    else if (parcel >= 0) map.parcels[parcel] = to;
    else {
      this.put(to, this.at(from));
      this.put(from, this.road);
    }
    return true;
  }

  /** Paints a cell, except the start and the last parcel. */
  paint(cell) {
    const { map, tool } = this;
    if (!this.inside(cell) || same(map.start, cell)) return;
    const parcel = this.parcelAt(cell);
    if (tool === "start") this.move(map.start, cell);
    else if (tool !== "parcel") {
      if (parcel >= 0 && map.parcels.length === 1) return this.emit("last");
      if (parcel >= 0) map.parcels.splice(parcel, 1);
      this.put(cell, this.idOf(tool));
    } else if (parcel < 0) {
      this.put(cell, this.road);
      map.parcels.push(cell);
    }
  }

  /** Begins a stroke. The move tool needs an item at the cell. */
  begin(cell) {
    const { map, tool } = this;
    const name = this.nameAt(cell);
    const held = name === "start" || (tool === "move" && name !== "road") ? cell : null;
    if (tool === "move" && !held) return;
    this.stroke = { before: JSON.stringify(map), cell, held };
    if (!held) {
      if (tool === "start" && name !== "parcel") this.put(cell, this.road);
      this.paint(cell);
    }
    this.emit("stroke");
  }

  /** Continues the stroke to a cell, along a straight line. */
  goOn(cell) {
    const { stroke } = this;
    if (!stroke || same(cell, stroke.cell)) return;
    const from = stroke.cell;
    const [dx, dy] = [cell[0] - from[0], cell[1] - from[1]];
    const n = Math.max(Math.abs(dx), Math.abs(dy));
    for (let i = 1; i <= n; i++) {
      const to = [from[0] + Math.round((i * dx) / n), from[1] + Math.round((i * dy) / n)];
      if (!stroke.held) this.paint(to);
      else if (this.move(stroke.held, to)) stroke.held = to;
    }
    // A held item that could not follow goes on from where it is.
    stroke.cell = stroke.held ?? cell;
    this.emit("stroke");
  }

  end() {
    if (this.stroke && this.stroke.before !== JSON.stringify(this.map)) {
      this.past = [...this.past, this.stroke.before].slice(-UNDONE);
      this.emit("end");
    }
    this.stroke = null;
  }

  edit(change) {
    this.stroke = { before: JSON.stringify(this.map) };
    change();
    this.end();
    this.emit("map");
  }

  undo() {
    this.end();
    if (!this.past.length) return;
    this.map = JSON.parse(this.past.pop());
    this.emit("map");
  }

  /** @param {number | null} value Null restores the default of the map size. */
  setNumber(name, value) {
    this.edit(() => {
      if (value === null) delete this.map.numbers[name];
      else this.map.numbers[name] = value;
    });
  }

  resize(width, height) {
    this.edit(() => {
      const { map } = this;
      map.cells = this.empty(width, height).map((row, y) => row.map((kind, x) => map.cells[y]?.[x] ?? kind));
      map.start = [Math.min(map.start[0], width - 1), Math.min(map.start[1], height - 1)];
      map.parcels = map.parcels.filter((parcel) => this.inside(parcel) && !same(parcel, map.start));
      const corner = same(map.start, [width - 1, height - 1]) ? [0, 0] : [width - 1, height - 1];
      if (!map.parcels.length) map.parcels = [corner];
      for (const stop of [map.start, ...map.parcels]) this.put(stop, this.road);
    });
  }
}
