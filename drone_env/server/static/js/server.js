// The server as the page sees it: whether it answers, and its news while a view shows them.
import { ApiError } from "./api.js";
import { Emitter } from "./base.js";

/** Milliseconds between two looks for a server that is away. */
const WAIT = 2000;
/** Milliseconds between two questions for news. */
const PAUSE = 3000;
const EPISODES = 50;

const sleep = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));

/** The questions for news; a hidden page does not ask. */
const NEWS = {
  requests: (api) => api.get("terminal_logs"),
  training: (api) => api.get("logs"),
  episodes: (api) => api.get("episodes", { limit: EPISODES }),
};

/**
 * Events: "state" ({state: "open" or "away"}), and news: "requests"
 * (`GET /terminal_logs`), "training" (`GET /logs`), "episodes" (`GET /episodes`).
 */
export class Server extends Emitter {
  /** @param {ReturnType<typeof import("./api.js").createApi>} api */
  constructor(api) {
    super();
    this.api = api;
    this.state = "open";
    this.timer = 0;
    this.waiting = [];
    this.watching = new AbortController();
    api.heard = (answers) => (answers ? this.open() : this.away());
  }

  open() {
    clearTimeout(this.timer);
    this.timer = 0;
    if (this.state === "open") return;
    this.state = "open";
    this.emit("state", { state: "open" });
    for (const go of this.waiting.splice(0)) go();
  }

  away() {
    if (this.timer) return;
    this.timer = setTimeout(() => this.look(), WAIT);
    this.state = "away";
    this.emit("state", { state: "away" });
  }

  /** Asks at once whether the server is back. */
  look() {
    clearTimeout(this.timer);
    this.timer = 0;
    this.api.get("health").catch(() => {});
  }

  async back() {
    if (this.state === "away") await new Promise((resolve) => this.waiting.push(resolve));
  }

  /** Posts, again when the server is back, and returns the answer. @returns {Promise<any>} */
  async post(path, data, given = {}) {
    try {
      return await this.api.post(path, data, given);
    } catch (error) {
      if (!(error instanceof ApiError && error.code === "away")) throw error;
    }
    await this.back();
    return this.post(path, data, given);
  }

  /** Asks for the news of these topics only, until the next call: "requests", "training", "episodes". */
  watch(topics) {
    this.watching.abort();
    this.watching = new AbortController();
    for (const topic of topics) this.follow(topic, this.watching.signal);
  }

  /** Asks until the next `watch`, and emits answers that differ from the last. */
  async follow(topic, signal) {
    let told = "";
    while (!signal.aborted) {
      const answer = document.hidden ? null : await NEWS[topic](this.api).catch(() => null);
      const text = JSON.stringify(answer);
      if (answer && text !== told && !signal.aborted) this.emit(topic, answer);
      if (answer) told = text;
      await sleep(PAUSE);
      await this.back();
    }
  }
}
