// The flight of one drone.
import { who } from "./format.js";

const WRITTEN = /^([^~]+)(?:~([\p{L}\p{N}_-]{0,20})(?:~(v?u?)(?:~([1-9]\d{0,5})~(.+))?)?)?$/u;

/** Who flew, as links write it: `human~Ada~vu~3~greedy` is Ada with values and undo from step 3 of Greedy. @param {Provenance} provenance */
export function writeProvenance({ pilot, person, values_used, undo_used, parent }) {
  const help = (values_used ? "v" : "") + (undo_used ? "u" : "");
  const before = parent ? [parent.step, writeProvenance(parent)] : [];
  const parts = [encodeURIComponent(pilot).replaceAll("~", "%7E"), person ?? "", help, ...before];
  return parts.join("~").replace(/~+$/, "");
}

/** The same from a link; null if the link is damaged. @param {string} text @returns {Provenance|null} */
export function readProvenance(text) {
  const [, pilot, person, help = "", step, before] = text.match(WRITTEN) ?? [];
  const parent = before ? readProvenance(before) : null;
  if (!pilot || (before && !parent)) return null;
  return {
    pilot: decoded(pilot),
    person: person || null,
    values_used: help.includes("v"),
    undo_used: help.includes("u"),
    parent: parent && { .../** @type {any} */ (parent), step: Number(step) },
  };
}

/** A part of an address; a damaged one is kept as it is. @param {string} text */
export const decoded = (text) => new URLSearchParams(`=${text}`).get("");

/** A frame without the best score still possible and what is lost, which come later. @param {Answer<"Frame">} frame */
export const unweighed = (frame) => ({ ...frame, value: null, regret: null });

export class Track {
  /**
   * @param {Context} context @param {Answer<"EpisodeView"> & Partial<Answer<"StartedFlight">>} flown
   * @param {boolean} live Whether it may continue.
   */
  constructor(context, { opening, frames, version = null, episode = null }, live = false) {
    const { name, colour, automatic } = context.pilot(opening.pilot);
    this.opening = opening;
    this.pilot = opening.pilot;
    const { person, values_used, undo_used, parent } = opening;
    /** Who flew, and with what help. @type {Provenance} */
    this.provenance = { pilot: this.pilot, person, values_used, undo_used, parent };
    this.automatic = automatic;
    /** Its colour, as a custom property of the style sheet: `--pilot-3`. */
    this.colour = `--pilot-${colour}`;
    /** The frames so far. */
    this.frames = frames.map(unweighed);
    /** The frames that a pilot of this page has yet to fly. @type {typeof this.frames} */
    this.rest = [];
    /** Whether the server is still computing them, and the step that the pilot then has flown. */
    this.coming = live && automatic;
    this.until = 0;
    this.loading = new AbortController();
    /** The version of a visitor's flight, and its changes that the server has not answered. @type {string|null} */
    this.version = version;
    /** @type {string[]} */
    this.pending = [];
    /** Whether its values are being loaded, or cannot be. */
    this.weighing = false;
    /** Id of the stored flight, which the page shows at the end. @type {string|null} */
    this.stored = episode;
    /** Whether it was over when the page met it: a flight from the store or a link. */
    this.brought = !live || this.done;
    /** In flights of this page the visitor is "You". */
    this.called = this.brought ? (person ?? who(context, this.pilot)) : name;
    /** Whether it was not flown by this page. */
    this.past = !live;
    this.live = live;
    /** The answer of `POST /annotate`, or null. @type {Answer<"AnalysedFlight">|null} */
    this.annotation = null;
    /** Why there is none. @type {string|null} */
    this.unexplained = null;
    this.record = null;
    /** The id of the stored flight, once it has ended here. @type {{id: string}|null} */
    this.episode = null;
    /** The calls of a language model by step, or null; a retry is one more call. */
    this.calls = null;
    this.forkedAt = parent?.step ?? null;
  }

  get name() {
    return this.forkedAt ? `${this.called} from step ${this.forkedAt}` : this.called;
  }

  /** Whether it was flown without values, undo and forks. */
  get plain() {
    const { values_used, undo_used, parent } = this.provenance;
    return !values_used && !undo_used && !parent;
  }

  /** Whether the server would fly it again: the flight of a pilot that this page has started. */
  get again() {
    return this.automatic && !this.past && this.forkedAt === null;
  }

  /** Whether a visitor flies it. */
  get byHand() {
    return this.live && !this.done && !this.automatic;
  }

  /** Whether values are hidden: a visitor flies without them. */
  get secret() {
    return this.byHand && !this.provenance.values_used;
  }

  get weighed() {
    return this.frames.some((frame) => frame.q_values);
  }

  /** Whether a pilot of this page flies it, not another agent such as a language model. */
  get ours() {
    return this.colour !== "--pilot-other";
  }

  get last() {
    return this.frames.at(-1);
  }

  /** The number of steps with those that are on their way to the server. */
  get flown() {
    return this.steps + this.pending.filter((change) => change !== "VALUES" && change !== "UNDO").length;
  }

  /** The move or the loop that lost most, once the flight is annotated; or null. */
  get worst() {
    return this.annotation?.worst ?? null;
  }

  get done() {
    return this.last.done;
  }

  /** Whether its pilot has yet to fly. */
  get goesOn() {
    return this.coming || this.rest.length > 0;
  }

  /** Adds the flight that the server has computed. @param {Answer<"AgentFlight">} flight */
  fill({ frames, episode }) {
    const newest = Math.max(this.steps, this.until);
    this.rest = frames.map(unweighed);
    this.frames = this.rest.splice(0, newest + 1);
    this.stored = episode;
    this.coming = false;
    this.brought = this.done;
  }

  /** Flies one step, at once or when the flight is there. */
  flyOn() {
    if (this.rest.length) this.frames.push(this.rest.shift());
    else if (this.coming) this.until = Math.max(this.steps, this.until) + 1;
  }

  /** The frames, and those that its pilot has yet to fly. */
  get all() {
    return [...this.frames, ...this.rest];
  }

  get steps() {
    return this.frames.length - 1;
  }

  /** The frame at a step, or the last frame. */
  frameAt(step) {
    return this.frames[Math.min(step, this.steps)];
  }

  /** Its actions up to a step. @returns {string[]} */
  actionsTo(step) {
    return this.frames.slice(1, step + 1).map((frame) => frame.action);
  }

  /** The same as links write them. */
  lettersTo(step) {
    return this.actionsTo(step).map(([letter]) => letter).join("");
  }

  /** [x, y] at a position between two steps. */
  at(position) {
    const k = Math.min(Math.floor(position), this.steps);
    const a = this.frames[k];
    const b = this.frames[k + 1] ?? a;
    const t = Math.min(position - k, 1);
    return [a.x + (b.x - a.x) * t, a.y + (b.y - a.y) * t];
  }

  /** The heading at a position, in radians; 0 is up. */
  heading(position) {
    for (let k = Math.min(Math.ceil(position), this.steps); k > 0; k--) {
      const dx = this.frames[k].x - this.frames[k - 1].x;
      const dy = this.frames[k].y - this.frames[k - 1].y;
      if (dx || dy) return Math.atan2(dx, -dy);
    }
    return 0;
  }
}
