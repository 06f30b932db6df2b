// The address of the page is its state: which view is shown, which flight stands in it, and which moment of it. Back,
// forward and reload show what the address says.
import { Emitter } from "./emitter.js";

const VIEWS = new Set(["fly", "compare", "learn", "api"]);
/** What views were called in links of earlier versions. */
const OLDER = { watch: "fly", race: "fly", replay: "fly", history: "compare", specs: "learn", logs: "api" };

/**
 * @typedef {Object} Address Null and an empty list stand for what it does not say.
 * @property {string} view One of `VIEWS`.
 * @property {string|null} task Short name, id or grader.
 * @property {number|string|null} seed What is no number of a map goes to the server as it is: its answer says what is allowed.
 * @property {string|null} profile
 * @property {string[]} pilots In Compare, too, those who are compared.
 * @property {string|null} episode A stored flight.
 * @property {number|null} step The moment that is shown; the start of a stored flight, and what is flown last of another.
 * @property {number|null} fork The step from which the last pilot has gone another way than `of`.
 * @property {string|null} actions All that this pilot has flown, a letter for each.
 * @property {string|null} of Who flew up to the fork.
 * @property {number|null} lesson
 *
 * Events: "address" (address) another one is shown.
 */
export class Router extends Emitter {
  constructor() {
    super();
    this.address = read(location);
    /** The last one of Fly: what the other views come back to. */
    this.flight = this.address.view === "fly" ? this.address : NOTHING;
    window.addEventListener("popstate", () => this.show(read(location)));
  }

  /** Goes to another address, from which Back comes here. @param {Partial<Address>} address */
  go(address) {
    const next = { ...NOTHING, ...address };
    if (linkOf(next).href !== linkOf(this.address).href) history.pushState(null, "", linkOf(next));
    this.show(next);
  }

  /** Goes to another view, to what stood there last. */
  open(view) {
    this.go(view === "fly" ? this.flight : { view });
  }

  /** Goes where a link of this page leads. */
  follow(href) {
    this.go(read(new URL(href)));
  }

  /** Says what is flown: a new entry for Back, unless the present address left open just this. @param {Partial<Address>} flown */
  flies(flown) {
    const { lesson } = this.address;
    const next = { ...NOTHING, lesson, ...flown };
    if (says(this.address, next)) history.replaceState(null, "", linkOf(next));
    else history.pushState(null, "", linkOf(next));
    this.address = this.flight = next;
  }

  /** Says which moment is shown, or what a fork has flown since: the same flight, so no new entry. @param {Partial<Address>} now */
  moment(now) {
    this.address = this.flight = { ...this.address, ...now };
    history.replaceState(null, "", linkOf(this.address));
  }

  show(address) {
    this.address = address;
    if (address.view === "fly") this.flight = address;
    this.emit("address", address);
  }
}

const NOTHING = {
  view: "fly",
  task: null,
  seed: null,
  profile: null,
  pilots: [],
  episode: null,
  step: null,
  fork: null,
  actions: null,
  of: null,
  lesson: null,
};

/** Whether an address says that this is flown, or leaves it open; rewards that it does not name are the server's. */
export function says(address, flown) {
  const open = (name) => address[name] === null || address[name].length === 0;
  const same = (name) => String(address[name]) === String(flown[name]);
  return (
    address.view === flown.view &&
    ["task", "seed", "pilots"].every((name) => open(name) || same(name)) &&
    ["profile", "episode", "fork"].every(same)
  );
}

/** @returns {Address} */
function read({ search, hash }) {
  const link = new URLSearchParams(search);
  const text = (name) => link.get(name) || null;
  const number = (name) => {
    const value = text(name);
    return value !== null && Number.isSafeInteger(Number(value)) ? Number(value) : value;
  };
  const count = (name) => (typeof number(name) === "number" ? Math.max(0, number(name)) : null);
  // Links of earlier versions name the view behind a #.
  const named = [link.get("view"), hash.slice(1)].map((view) => (Object.hasOwn(OLDER, view) ? OLDER[view] : view));
  return {
    view: named.find((view) => VIEWS.has(view)) ?? "fly",
    task: text("task"),
    seed: number("seed"),
    profile: text("profile"),
    // Split before it is decoded: agents from elsewhere may have commas in their names.
    pilots: (search.match(/[?&]pilots?=([^&]*)/)?.[1] ?? "").split(",").filter(Boolean).map(decoded),
    episode: text("episode"),
    step: count("step"),
    fork: count("fork"),
    actions: text("actions"),
    of: text("of"),
    lesson: count("lesson"),
  };
}

const decoded = (text) => new URLSearchParams(`=${text}`).get("");

/** The link to an address. @param {Partial<Address>} address */
export function linkOf(address) {
  const { view, pilots, ...rest } = { ...NOTHING, ...address };
  const parts = view === "fly" ? [] : [`view=${view}`];
  const say = (name) => {
    if (rest[name] !== null && rest[name] !== "") parts.push(`${name}=${encodeURIComponent(rest[name])}`);
  };
  say("episode");
  say("task");
  say("seed");
  if (pilots.length) parts.push(`${pilots.length > 1 ? "pilots" : "pilot"}=${pilots.map(encodeURIComponent).join(",")}`);
  for (const name of ["profile", "fork", "of", "actions", "step", "lesson"]) say(name);
  const url = new URL(document.baseURI);
  url.search = parts.join("&");
  url.hash = "";
  return url;
}
