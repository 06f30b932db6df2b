// The optimum of a drawn map, which the server computes after each change.
import { ApiError } from "./api.js";
import { Emitter } from "./base.js";
import { setText } from "./dom.js";
import { counted, points } from "./format.js";

/** Milliseconds until the next request to a busy server. */
const AGAIN = 2000;
/** Milliseconds until the page stops showing the optimum of the map before. */
const LATE = 400;

/** Events: "answer" (wrong) another answer is shown, or none while the server computes; why the map is invalid, or null. */
export class Worth extends Emitter {
  /** @param {HTMLElement} root @param {Context} context @param {Drawing} drawing */
  constructor(root, { api }, drawing) {
    super();
    this.api = api;
    this.drawing = drawing;
    /** The answer of `POST /maps/worth`, with the parcels of that map; null until it arrives. */
    this.answer = null;
    this.asking = false;
    this.newest = null;
    this.score = root.querySelector("#map-optimum");
    this.note = root.querySelector("#map-note");
    /** @type {HTMLElement} */
    this.problem = root.querySelector(".problem");
  }

  /** Asks for the present map: one request at a time, then one for the newest map. */
  async ask() {
    this.newest = this.drawing.map;
    this.score.classList.add("waiting");
    if (this.asking) return;
    this.asking = true;
    while (this.newest) {
      const late = setTimeout(() => this.show(null, null), LATE);
      const sent = this.newest;
      const parcels = sent.parcels.length;
      this.newest = null;
      let answer = null;
      let wrong = null;
      try {
        answer = await this.api.post("maps/worth", sent);
      } catch (error) {
        if (!(error instanceof ApiError)) throw error;
        wrong = error.message;
        if (error.status === 503) setTimeout(() => sent === this.drawing.map && this.ask(), AGAIN);
      }
      clearTimeout(late);
      // The visitor may have opened another map.
      if (sent === this.drawing.map) this.show(answer && { ...answer, parcels }, wrong);
    }
    this.asking = false;
    this.score.classList.remove("waiting");
  }

  /** Shows an answer, or why there is none; both null while the server computes. */
  show(answer, wrong) {
    this.answer = answer;
    const { optimum, parcels } = answer ?? {};
    setText(this.score, optimum ? points(optimum.score) : "–");
    setText(this.note, answer ? inWords(optimum, parcels) : wrong === null ? "Computing …" : "");
    this.problem.hidden = wrong === null;
    setText(this.problem, wrong ?? "");
    this.emit("answer", wrong);
  }
}

function inWords(optimum, parcels) {
  if (!optimum) return "This map is too large for the exact solver.";
  if (optimum.success) return `${["The parcel", "Both parcels"][parcels - 1] ?? `All ${parcels} parcels`} in ${counted(optimum.steps, "step")}`;
  return `At best ${optimum.deliveries} of ${parcels} parcels: the battery or the steps run out`;
}
