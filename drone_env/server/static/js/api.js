// HTTP requests. URLs are relative to the page, which may have a path prefix.
import { recall, remember } from "./base.js";
import { el, toast } from "./dom.js";
import { sentence } from "./format.js";

const TOKEN = "drone-env-token";
/** Characters that a header may contain. */
const SENDABLE = /^[\x21-\x7e]+$/;

/** An unsuccessful response; status 0 if the server cannot be reached. */
export class ApiError extends Error {
  constructor(status, code, detail) {
    super(sentence(detail));
    this.status = status;
    this.code = code;
  }
}

/** The answer of a request; null if the server refuses it. A message then shows the reason. @template T @param {() => T|Promise<T>} ask */
export async function tried(ask) {
  try {
    return await ask();
  } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    toast(error.message);
    return null;
  }
}

export function createApi() {
  let token = recall(TOKEN, "sessionStorage");
  let asking = null;

  async function call(method, path, body) {
    const sent = token;
    const headers = token ? { Authorization: `Bearer ${token}` } : {};
    if (body !== undefined) headers["Content-Type"] = "application/json";
    let response;
    try {
      response = await fetch(address(path), {
        method,
        headers,
        body: body === undefined ? undefined : JSON.stringify(body),
        credentials: "same-origin",
      });
    } catch {
      throw new ApiError(0, "away", "The server cannot be reached.");
    }
    if (response.status === 401) {
      // Several requests may wait for one token.
      while (token === sent || !SENDABLE.test(token)) {
        asking ??= askForToken(token !== null).finally(() => (asking = null));
        token = await asking;
      }
      remember(TOKEN, token, "sessionStorage");
      return call(method, path, body);
    }
    const answer = await response.json().catch(() => null);
    if (!response.ok) {
      throw new ApiError(response.status, answer?.code ?? "http", answer?.detail ?? `HTTP ${response.status}`);
    }
    return answer;
  }

  return {
    get: (path, query = {}) => call("GET", path + search(query)),
    post: (path, body) => call("POST", path, body),
    /** The subprotocols of the WebSocket, with the token if there is one. */
    protocols: () => (token ? ["drone-env", `bearer.${base64url(token)}`] : ["drone-env"]),
  };
}

export function address(path) {
  return new URL(path.replace(/^\//, ""), document.baseURI);
}

function search(query) {
  const given = Object.entries(query).filter(([, value]) => value !== null && value !== undefined && value !== "");
  return given.length ? `?${new URLSearchParams(given)}` : "";
}

function base64url(text) {
  const bytes = String.fromCharCode(...new TextEncoder().encode(text));
  return btoa(bytes).replaceAll("+", "-").replaceAll("/", "_").replace(/=+$/, "");
}

/** Asks the visitor for the token. @param {boolean} wrong Whether the server rejected a token. @returns {Promise<string>} */
function askForToken(wrong) {
  const dialog = document.getElementById("token");
  const input = el("input.input", {
    type: "password",
    id: "token-input",
    autocomplete: "current-password",
    required: true,
  });
  const form = el(
    "form",
    { method: "dialog" },
    el("h2", { id: "token-title", text: "This server requires a token" }),
    el("p.note", {
      text: wrong
        ? "The server rejected this token. Try another one."
        : "The operator of the server has it. This tab remembers it.",
    }),
    el("label.eyebrow", { for: "token-input", text: "Token" }),
    input,
    el("button.button.primary", { type: "submit", text: "Continue" }),
  );
  dialog.replaceChildren(form);
  if (!dialog.open) dialog.showModal();
  return new Promise((resolve) => {
    let given = null;
    form.addEventListener("submit", () => (given = input.value.trim()));
    // The page needs a token, so the dialog opens again after Escape.
    dialog.onclose = () => (given === null ? dialog.showModal() : resolve(given));
  });
}
