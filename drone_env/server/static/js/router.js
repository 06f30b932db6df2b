// The address of the page is its state: which view is shown, which flight stands in it, and which moment of it. Back,
// forward and reload show what the address says.
import { Emitter } from "./base.js";
import { copyText, toast } from "./dom.js";

const VIEWS = new Set(["fly", "compare", "learn", "api", "draw"]);

/** Milliseconds between two changes of an entry: browsers allow few. */
const PAUSE = 200;

/**
 * @typedef {Object} Address Null and an empty list stand for what it does not say.
 * @property {string} view One of `VIEWS`.
 * @property {string|null} task Short name, id or grader.
 * @property {number|string|null} seed What is no number of a map goes to the server as it is: its answer says what is allowed.
 * @property {string|null} profile
 * @property {string[]} pilots In Compare, too, those who are compared.
 * @property {string|null} episode A stored flight.
 * @property {string|null} file Name of a file that was opened on this page, which no link leads to.
 * @property {number|null} step The moment that is shown; the start of a stored flight, and what is flown last of another.
 * @property {number|null} flown How far was flown, where an earlier moment is shown.
 * @property {number|null} fork The step from which the last pilot has gone another way than `of`.
 * @property {string|null} actions All that this pilot has flown, a letter for each; without a fork, the visitor.
 * @property {string|null} of Who flew up to the fork; without one, the visitor, as records say it.
 * @property {number|null} lesson From 1.
 * @property {string[]} unread What of it was not understood.
 *
 * Events: "address" (address) another one is shown.
 */
export class Router extends Emitter {
  constructor() {
    super();
    this.address = read(location);
    /** The last one of Fly: what the other views come back to. */
    this.flight = this.address.view === "fly" ? this.address : NOTHING;
    this.timer = 0;
    window.addEventListener("popstate", () => this.show(read(location)));
  }

  /** Goes to another address, from which Back comes here. @param {Partial<Address>} address */
  go(address) {
    const next = { ...NOTHING, ...address };
    this.write();
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

  /** Whether the address asks for nothing. */
  get bare() {
    return linkOf(this.address).search === "";
  }

  /**
   * Says what is flown: a new entry for Back, unless the present address left open just this.
   *
   * @param {Partial<Address>} flown @param {boolean} entry Whether it is a new one even then.
   */
  flies(flown, entry = false) {
    const { lesson } = this.address;
    const next = { ...NOTHING, lesson, ...flown };
    this.write();
    if (!entry && says(this.address, next)) history.replaceState(null, "", linkOf(next));
    else history.pushState(null, "", linkOf(next));
    this.address = this.flight = next;
  }

  /** Says which moment is shown, or what has been flown since: the same flight, so no new entry. @param {Partial<Address>} now */
  moment(now) {
    if (Object.keys(now).every((name) => this.address[name] === now[name])) return;
    this.address = this.flight = { ...this.address, ...now };
    this.timer ||= setTimeout(() => this.write(), PAUSE);
  }

  /** Writes what was said of the present entry. */
  write() {
    if (!this.timer) return;
    clearTimeout(this.timer);
    this.timer = 0;
    history.replaceState(null, "", linkOf(this.address));
  }

  /** Copies the link to what is shown. */
  copy() {
    if (this.address.file) toast("No link leads to a file: send the file itself.");
    else copyText(linkOf(this.address).href, "Link copied.");
  }

  show(address) {
    // What was said of an entry that Back has left is too late.
    clearTimeout(this.timer);
    this.timer = 0;
    this.address = address;
    if (address.view === "fly") this.flight = address;
    this.emit("address", address);
  }
}

/** What an address says that says nothing. */
export const NOTHING = {
  view: "fly",
  task: null,
  seed: null,
  profile: null,
  pilots: [],
  episode: null,
  file: null,
  step: null,
  flown: null,
  fork: null,
  actions: null,
  of: null,
  lesson: null,
  unread: [],
};

/** Whether an address says that this is flown, or leaves it open; rewards that it does not name are the server's. */
export function says(address, flown) {
  const open = (name) => address[name] === null || address[name].length === 0;
  const same = (name) => String(address[name]) === String(flown[name]);
  return (
    address.view === flown.view &&
    ["task", "seed", "pilots"].every((name) => open(name) || same(name)) &&
    ["profile", "episode", "file", "fork"].every(same)
  );
}

/** @returns {Address} */
function read({ search }) {
  const link = new URLSearchParams(search);
  const text = (name) => link.get(name) || null;
  const number = (name) => {
    const value = text(name);
    return value !== null && Number.isSafeInteger(Number(value)) ? Number(value) : value;
  };
  const unread = [];
  const count = (name, least = 0) => {
    const value = number(name);
    if (value === null || (Number.isInteger(value) && value >= least)) return value;
    unread.push(`${name}=${value}`);
    return null;
  };
  const named = link.get("view") ?? "fly";
  const view = VIEWS.has(named) ? named : "fly";
  if (view !== named) unread.push(`view=${named}`);
  return {
    view,
    task: text("task"),
    seed: number("seed"),
    profile: text("profile"),
    // Split before it is decoded: agents from elsewhere may have commas in their names.
    pilots: (search.match(/[?&]pilots?=([^&]*)/)?.[1] ?? "").split(",").filter(Boolean).map(decoded),
    episode: text("episode"),
    file: text("file"),
    step: count("step"),
    flown: count("flown"),
    fork: count("fork"),
    actions: text("actions"),
    of: text("of"),
    lesson: count("lesson", 1),
    unread,
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
  say("file");
  say("task");
  say("seed");
  if (pilots.length) parts.push(`${pilots.length > 1 ? "pilots" : "pilot"}=${pilots.map(encodeURIComponent).join(",")}`);
  for (const name of ["profile", "fork", "of", "actions", "step", "flown", "lesson"]) say(name);
  const url = new URL(document.baseURI);
  url.search = parts.join("&");
  url.hash = "";
  return url;
}
