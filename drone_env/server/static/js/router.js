// The address of the page is its state: which view is shown, and which flight stands in it. Back, forward and reload
// show what the address says.
import { Emitter } from "./emitter.js";

const VIEWS = new Set(["watch", "race", "replay", "history", "learn", "api"]);
const RENAMED = { specs: "learn", logs: "api" };
/** Whether flights are flown in a view. */
export const isFlown = (view) => view === "watch" || view === "race";

/**
 * @typedef {Object} Address Null and an empty list stand for what it does not say.
 * @property {string} view One of `VIEWS`.
 * @property {string|null} task Short name, id or grader.
 * @property {number|string|null} seed What is no number of a map goes to the server as it is: its answer says what is allowed.
 * @property {string|null} profile
 * @property {string[]} pilots
 * @property {string|null} episode Of a replay.
 * @property {number|null} lesson Of the tutorial, from 1.
 *
 * Events: "address" (address) another one is shown.
 */
export class Router extends Emitter {
  constructor() {
    super();
    this.address = read(location);
    /** The last one with a flight that can be flown: what Watch and Race come back to. */
    this.flight = this.address;
    /** The last replay. */
    this.replay = this.address.view === "replay" ? this.address : { view: "replay" };
    window.addEventListener("popstate", () => this.show(read(location)));
  }

  /** Goes to another address, from which Back comes here. @param {Partial<Address>} address */
  go(address) {
    const next = { ...NOTHING, ...address };
    if (next.view === "fly") next.view = next.episode ? "replay" : "watch";
    if (linkOf(next).href !== linkOf(this.address).href) history.pushState(null, "", linkOf(next));
    this.show(next);
  }

  /** Goes to another view, to what stood there last. */
  open(view) {
    if (view === "watch") this.go({ ...this.flight, view, pilots: this.flight.pilots.slice(0, 1) });
    else if (view === "race") this.go({ ...this.flight, view, pilots: [] });
    else this.go(view === "replay" ? this.replay : { view });
  }

  /** Says what is flown: a new entry for Back, unless the present address left open just this. @param {Partial<Address>} flown */
  flies(flown) {
    const next = { ...this.address, ...flown };
    if (says(this.address, next)) history.replaceState(null, "", linkOf(next));
    else history.pushState(null, "", linkOf(next));
    this.address = this.flight = next;
  }

  show(address) {
    this.address = address;
    if (address.view === "replay") this.replay = address;
    if (isFlown(address.view) && address.task !== null) this.flight = address;
    this.emit("address", address);
  }
}

const NOTHING = { view: "watch", task: null, seed: null, profile: null, pilots: [], episode: null, lesson: null };

/** Whether an address says that this is flown, or leaves it open; rewards that it does not name are the server's. */
export function says(address, flown) {
  const open = (name) => address[name] === null || address[name].length === 0;
  const same = (name) => String(address[name]) === String(flown[name]);
  return ["task", "seed", "pilots"].every((name) => open(name) || same(name)) && same("profile");
}

/** @returns {Address} */
function read({ search, hash }) {
  const link = new URLSearchParams(search);
  const pilots = (link.get("pilots") ?? link.get("pilot") ?? "").split(",").filter(Boolean);
  const seed = link.get("seed");
  const episode = link.get("episode") || null;
  // Links of earlier versions name the view behind a #.
  const named = [link.get("view"), hash.slice(1)]
    .map((view) => (Object.hasOwn(RENAMED, view) ? RENAMED[view] : view))
    .find((view) => VIEWS.has(view));
  return {
    view: named ?? (episode ? "replay" : pilots.length > 1 ? "race" : "watch"),
    task: link.get("task"),
    seed: !seed ? null : Number.isSafeInteger(Number(seed)) ? Number(seed) : seed,
    profile: link.get("profile"),
    pilots,
    episode,
    lesson: Number(link.get("lesson")) || null,
  };
}

/** The link to an address. @param {Partial<Address>} address */
export function linkOf({ view, task, seed, profile, pilots, episode, lesson }) {
  const url = new URL(document.baseURI);
  const parts = [];
  const say = (name, value) => {
    if (value !== null && value !== undefined && value !== "") parts.push(`${name}=${encodeURIComponent(value)}`);
  };
  if (isFlown(view) || view === undefined || (view === "fly" && !episode)) {
    say("task", task);
    say("seed", seed);
    if (pilots.length) parts.push(`${pilots.length > 1 ? "pilots" : "pilot"}=${pilots.map(encodeURIComponent).join(",")}`);
    say("profile", profile);
    if (view === "race" && pilots.length < 2) say("view", view);
    say("lesson", lesson);
  } else if (episode) say("episode", episode);
  else say("view", view);
  url.search = parts.join("&");
  url.hash = "";
  return url;
}
