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

  // The page's own questions for this log are no news.
  const isNews = ({ path }) => !path.endsWith("/terminal_logs");
  server.on("requests", (log) => fill(requests, log.requests.filter(isNews).slice(-KEPT).map(requestLine)));
  server.on("training", ({ lines }) => fill(training, lines.map((line) => el("li", { text: line }))));
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

/** Fills a list, which stays scrolled to its newest line unless the visitor scrolls up. */
function fill(list, lines) {
  const frame = list.parentElement;
  const atEnd = frame.scrollTop + frame.clientHeight >= frame.scrollHeight - 8;
  list.replaceChildren(...lines);
  if (atEnd) frame.scrollTop = frame.scrollHeight;
}
