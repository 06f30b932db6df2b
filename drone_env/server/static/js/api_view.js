// API: how programs connect to this server, and its live logs of requests and training.
import { address } from "./api.js";
import { el, snippet } from "./dom.js";
import { fixed, LOCALE } from "./format.js";

const KEPT = 200;

/** @param {HTMLElement} root @param {Context} context */
export function mountApi(root, context) {
  const { api, server } = context;
  const url = address(".").href.replace(/\/$/, "");
  root.append(document.getElementById("api").content);
  root.querySelector("code").textContent = url;
  root.querySelector("span").hidden = !api.guarded();
  for (const program of root.querySelectorAll("pre")) program.replaceWith(snippet(program, { URL: url }));
  const [requests, training] = root.querySelectorAll("ol");

  server.on("requests", (message) => add(requests, message.fresh, message.requests.map(requestLine)));
  server.on("training", ({ lines }) => add(training, true, lines.map((line) => el("li", { text: line }))));
  context.on("view", (view) => view === "api" && server.watch(["requests", "training"]));
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

/** Adds lines to a list, or replaces them; it stays scrolled to its newest line unless the visitor scrolls up. */
function add(list, fresh, lines) {
  const frame = list.parentElement;
  const atEnd = frame.scrollTop + frame.clientHeight >= frame.scrollHeight - 8;
  list.replaceChildren(...[...(fresh ? [] : list.children), ...lines].slice(-KEPT));
  if (atEnd) frame.scrollTop = frame.scrollHeight;
}
