// Logs, live: the requests that the server answers, the training, and the flights that end.
import { el } from "./dom.js";
import { fixed, moment, outcome, points, title } from "./format.js";

const KEPT = 200;
const TOPICS = ["requests", "training", "episodes"];

/** @param {HTMLElement} root An empty section. @param {import("./context.js").Context} context */
export function mount(root, context) {
  const requests = new Log("Requests", "log-requests", "No request yet.");
  const training = new Log("Training", "log-training", "No training has written here. It starts with: drone-env train");
  const flights = new Log("Flights", "log-flights", "No flight has ended yet.");
  root.append(
    el("div.view-head", el("h2", { text: "Logs" })),
    el("div.logs", requests.root, training.root, flights.root),
  );

  const { live } = context;
  live.on("requests", (message) => requests.add(message.requests.map((r) => [r.number, requestLine(r)])));
  live.on("training", ({ lines }) => {
    training.clear();
    training.add(lines.map((line) => [null, el("li", { text: line })]));
  });
  live.on("episodes", ({ episodes }) => flights.add(byTime(episodes).map((e) => [e.id, flightLine(e, context)])));
  // Another process may answer after that, which counts its requests from 1 again.
  live.on("state", ({ state }) => {
    if (state === "open") requests.clear();
  });

  let unsubscribe = [];
  context.on("view", (view) => {
    if (view === "logs" && !unsubscribe.length) unsubscribe = TOPICS.map((topic) => live.subscribe(topic));
    else if (view !== "logs") {
      unsubscribe.forEach((end) => end());
      unsubscribe = [];
    }
  });
}

const byTime = (episodes) => [...episodes].sort((a, b) => (a.finished_at < b.finished_at ? -1 : 1));

function requestLine({ time, method, path, status, milliseconds }) {
  return el(
    "li",
    { data: { bad: status >= 400 ? "yes" : "no" } },
    el("time.dim", { datetime: time, text: new Date(time).toLocaleTimeString() }),
    ` ${method} `,
    el("span.path", { text: path }),
    ` ${status} `,
    el("span.dim", { text: `${fixed(milliseconds, 1)} ms` }),
  );
}

function flightLine(e, context) {
  return el(
    "li",
    el("time.dim", { datetime: e.finished_at, text: moment(e.finished_at) }),
    el("span", {
      text: ` ${title(e.task)} ${e.seed}, ${e.agent}: ${outcome(e)}, ${e.steps} steps, score ${points(e.score)} `,
    }),
    el("button.link", {
      text: "Replay",
      "aria-label": `Replay ${e.task}, map ${e.seed}, by ${e.agent}`,
      press: () => context.emit("replay", e.id),
    }),
  );
}

/** A list that grows downwards and keeps its newest lines in sight, unless it was scrolled away from them. */
class Log {
  constructor(name, id, empty) {
    this.keys = new Set();
    this.list = el("ol", { id });
    this.frame = el(
      "div.log-frame",
      { tabindex: "0", role: "log", "aria-live": "off", "aria-labelledby": `${id}-title` },
      this.list,
    );
    this.none = el("p.note", { text: empty });
    this.root = el(
      "section.log",
      { "aria-labelledby": `${id}-title` },
      el("h3", { id: `${id}-title`, text: name }),
      this.none,
      this.frame,
    );
    this.frame.hidden = true;
  }

  /** @param {[any, HTMLElement][]} lines Each with a key that is shown once, or null. */
  add(lines) {
    const fresh = lines.filter(([key]) => key === null || !this.keys.has(key));
    if (!fresh.length) return;
    this.none.hidden = true;
    this.frame.hidden = false;
    const atEnd = this.frame.scrollTop + this.frame.clientHeight >= this.frame.scrollHeight - 8;
    for (const [key] of fresh) if (key !== null) this.keys.add(key);
    this.list.append(...fresh.map(([, line]) => line));
    while (this.list.childElementCount > KEPT) this.list.firstElementChild.remove();
    if (atEnd) this.frame.scrollTop = this.frame.scrollHeight;
  }

  clear() {
    this.keys.clear();
    this.list.replaceChildren();
    this.none.hidden = false;
    this.frame.hidden = true;
  }
}
