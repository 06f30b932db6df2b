// HTTP requests. URLs are relative to the page, which may have a path prefix.
import { recall, remember } from "./base.js";
import { toast } from "./dom.js";
import { sentence } from "./format.js";

const TOKEN = "drone-env-token";

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

  /** @typedef {RequestInit & {data?: object, session?: string}} Given What a request has beside its address. */
  /** The response of a request. @param {Given} given @returns {Promise<Response>} @throws {ApiError} */
  async function request(method, path, given) {
    const { data, session, ...options } = given;
    const sent = token;
    /** @type {Record<string, string>} */
    const headers = token ? { Authorization: `Bearer ${token}` } : {};
    if (data !== undefined) headers["Content-Type"] = "application/json";
    if (session) headers["X-Session-Id"] = session;
    const body = data === undefined ? undefined : JSON.stringify(data);
    const how = { ...options, method, headers, body, credentials: "same-origin" };
    const response = await fetch(address(path), /** @type {RequestInit} */ (how)).catch(() => null);
    // Proxies answer 502 and 504 for a server that is away.
    if (!response || [502, 504].includes(response.status)) {
      if (options.signal?.aborted) throw new ApiError(0, "aborted", "This is no longer needed.");
      api.heard(false);
      throw new ApiError(0, "away", "The server cannot be reached.");
    }
    api.heard(true);
    if (response.status === 401) {
      // Several requests may wait for one token.
      if (token === sent) {
        asking ??= askForToken(token !== null).finally(() => (asking = null));
        token = await asking;
      }
      remember(TOKEN, token, "sessionStorage");
      return request(method, path, given);
    }
    if (response.ok) return response;
    const answer = await response.json().catch(() => null);
    throw new ApiError(response.status, answer?.code ?? "http", answer?.detail ?? `HTTP ${response.status}`);
  }

  /** @param {Given} given @returns {Promise<any>} */
  async function call(method, path, given = {}) {
    const response = await request(method, path, given);
    return response.json().catch(() => null);
  }

  const api = {
    /** Called after each request with whether the server has answered. @type {(answers: boolean) => void} */
    heard() {},
    get: (path, query = {}) => call("GET", path + search(query)),
    /** @param {Given} [given] Also `session`, the session that it changes. */
    post: (path, data, given) => call("POST", path, { data, ...given }),
    /** Ends a session, also while the page closes. */
    end: (session) => request("DELETE", "session", { session, keepalive: true }).catch(() => {}),
    /** Whether the server requires a token. */
    guarded: () => token !== null,
  };
  return api;
}

export function address(path) {
  return new URL(path.replace(/^\//, ""), document.baseURI);
}

function search(query) {
  const given = Object.entries(query).filter(([, value]) => value !== null && value !== undefined && value !== "");
  return given.length ? `?${new URLSearchParams(given)}` : "";
}

/** Asks the visitor for the token. @param {boolean} wrong Whether the server rejected a token. @returns {Promise<string>} */
function askForToken(wrong) {
  const dialog = document.getElementById("token");
  const input = dialog.querySelector("input");
  input.value = dialog.returnValue = "";
  dialog.querySelector("p").textContent = wrong
    ? "The server rejected this token. Try another one."
    : "The operator of the server has it. This tab remembers it.";
  dialog.showModal();
  return new Promise((resolve) => {
    // The page needs a token, so the dialog opens again after Escape.
    dialog.onclose = () => (dialog.returnValue ? resolve(input.value.trim()) : dialog.showModal());
  });
}
