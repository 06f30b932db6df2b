// API: how programs connect to this server, and its live logs of requests and training.
import { address } from "./api.js";
import { el, snippet } from "./dom.js";
import { fixed, LOCALE } from "./format.js";

const KEPT = 200;
const TOPICS = ["requests", "training"];

/** @param {HTMLElement} root @param {Context} context */
export function mountApi(root, context) {
  const { api, server } = context;
  const url = address(".").href.replace(/\/$/, "");
  root.append(document.getElementById("api").content);
  root.querySelector("code").textContent = url;
  root.querySelector("span").hidden = !api.guarded();
  for (const program of root.querySelectorAll("pre")) program.replaceWith(snippet(program, { URL: url }));
  const [requests, training] = [...root.querySelectorAll("ol")].map((list) => log(list));

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
function log(list) {
  const frame = list.parentElement;
  function add(lines) {
    const atEnd = frame.scrollTop + frame.clientHeight >= frame.scrollHeight - 8;
    list.append(...lines);
    while (list.childElementCount > KEPT) list.firstElementChild.remove();
    if (atEnd) frame.scrollTop = frame.scrollHeight;
  }
  return { add, clear: () => list.replaceChildren() };
}
