// API: how programs connect to this server, and its live logs of requests and training.
import { address } from "./api.js";
import { copyText, el } from "./dom.js";
import { fixed } from "./format.js";

const KEPT = 200;
const TOKEN = "Authorization: Bearer TOKEN";
const TOPICS = ["requests", "training"];

/** Example clients. @param {string} url Of the server. @returns {[string, string][]} Names and programs. */
const snippets = (url) => [
  [
    "HTTP, by curl",
    `curl --silent --cookie-jar jar --json '{"task_name": "easy", "seed": 7}' ${url}/reset
curl --silent --cookie jar --json '{"direction": "RIGHT"}' ${url}/step
curl --silent --cookie jar ${url}/grade/easy
curl --silent --cookie jar --request DELETE ${url}/session`,
  ],
  [
    "OpenEnv, in Python",
    `from drone_env.client import DroneDeliveryClient
from drone_env.models import DroneAction

with DroneDeliveryClient("${url}").sync() as env:
    result = env.reset(task_name="hard", seed=7)
    while not result.done:
        result = env.step(DroneAction(direction="RIGHT"))
    print(result.observation.score, env.state().seed)`,
  ],
];

/** @param {HTMLElement} root @param {Context} context */
export function mount(root, context) {
  const { api, server } = context;
  const url = address(".").href.replace(/\/$/, "");
  const token = api.guarded() ? el("span", " Send ", el("code", { text: TOKEN }), " with each request.") : null;
  const requests = new Log("Requests", "log-requests", "No request yet.");
  const training = new Log("Training", "log-training", "No training log yet. To start a training, run: drone-env train");
  root.append(
    el(
      "div.view-head",
      el("h2", { text: "API" }),
      el("a.button.primary", { href: "docs", text: "All endpoints" }),
    ),
    el("p.about", "This server is ", el("code", { text: url }), ". Any HTTP client can fly here.", token),
    el("div.snippets", ...snippets(url).map(snippet)),
    el("div.logs", requests.root, training.root),
  );

  server.on("requests", (message) => {
    if (message.fresh) requests.clear();
    requests.add(message.requests.map(requestLine));
  });
  server.on("training", ({ lines }) => {
    training.clear();
    training.add(lines.map((line) => el("li", { text: line })));
  });
  context.on("view", (view) => view === "api" && server.watch(TOPICS));
}

function snippet([name, text]) {
  const press = () => copyText(text, "Copied.");
  const copy = el("button.button.small", { text: "Copy", "aria-label": `Copy: ${name}`, press });
  return el("section.snippet", el("h3", { text: name }), copy, el("pre", el("code", { text })));
}

function requestLine({ time, method, path, status, milliseconds }) {
  return el(
    "li",
    { data: { bad: status >= 400 ? "yes" : "no" } },
    el("time.dim", { datetime: time, text: new Date(time).toLocaleTimeString() }),
    ` ${method} ${path} ${status} `,
    el("span.dim", { text: `${fixed(milliseconds, 1)} ms` }),
  );
}

/** A list that stays scrolled to its newest line unless the visitor scrolls up. */
class Log {
  constructor(name, id, empty) {
    this.list = el("ol", { id });
    this.frame = el(
      "div.log-frame",
      { tabindex: "0", role: "log", "aria-live": "off", "aria-labelledby": `${id}-title`, hidden: true },
      this.list,
    );
    this.none = el("p.note", { text: empty });
    const heading = el("h3", { id: `${id}-title`, text: name });
    this.root = el("section.log", { "aria-labelledby": `${id}-title` }, heading, this.none, this.frame);
  }

  add(lines) {
    if (!lines.length) return;
    this.show(true);
    const atEnd = this.frame.scrollTop + this.frame.clientHeight >= this.frame.scrollHeight - 8;
    this.list.append(...lines);
    while (this.list.childElementCount > KEPT) this.list.firstElementChild.remove();
    if (atEnd) this.frame.scrollTop = this.frame.scrollHeight;
  }

  clear() {
    this.list.replaceChildren();
    this.show(false);
  }

  show(some) {
    this.frame.hidden = !some;
    this.none.hidden = some;
  }
}
