// API: how programs connect to this server, and its live logs of requests and training.
import { address } from "./api.js";
import { el, snippet } from "./dom.js";
import { fixed, LOCALE } from "./format.js";

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
  const requests = log("Requests", "log-requests", "No request yet.");
  const training = log("Training", "log-training", "No training log yet. To start a training, run: drone-env train");
  root.append(
    el(
      "div.view-head",
      el("h2", { text: "API" }),
      el("a.button.primary", { href: "docs", text: "All endpoints" }),
    ),
    el("p.about", "This server is ", el("code", { text: url }), ". Any HTTP client can fly here.", token),
    el("div.snippets", ...snippets(url).map(([name, text]) => snippet(name, text))),
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

function requestLine({ time, method, path, status, milliseconds }) {
  return el(
    "li",
    { data: { bad: status >= 400 ? "yes" : "no" } },
    el("time.dim", { datetime: time, text: new Date(time).toLocaleTimeString(LOCALE) }),
    ` ${method} ${path} ${status} `,
    el("span.dim", { text: `${fixed(milliseconds, 1)} ms` }),
  );
}

/** A list that stays scrolled to its newest line unless the visitor scrolls up. */
function log(name, id, empty) {
  const title = `${id}-title`;
  const list = el("ol", { id });
  const frame = el("div.log-frame", { tabindex: "0", role: "log", "aria-live": "off", "aria-labelledby": title }, list);
  const head = el("h3", { id: title, text: name });
  const root = el("section.log", { "aria-labelledby": title }, head, el("p.note", { text: empty }), frame);
  function add(lines) {
    const atEnd = frame.scrollTop + frame.clientHeight >= frame.scrollHeight - 8;
    list.append(...lines);
    while (list.childElementCount > KEPT) list.firstElementChild.remove();
    if (atEnd) frame.scrollTop = frame.scrollHeight;
  }
  return { root, add, clear: () => list.replaceChildren() };
}
