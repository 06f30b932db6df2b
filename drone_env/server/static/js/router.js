// The address is the state of the page: the view, the flight and its moment. Back, Forward and Reload restore it.
import { Emitter } from "./base.js";
import { copyText } from "./dom.js";
import { shortened } from "./format.js";
import { decoded, readProvenance } from "./track.js";

const VIEWS = new Set(["fly", "compare", "learn", "api", "draw"]);

/** Milliseconds between two changes of a history entry: Safari allows 100 in 30 s. */
const PAUSE = 400;

/** Events: "address" (address) the page shows another address. */
export class Router extends Emitter {
  constructor() {
    super();
    this.address = read(location);
    /** The last address of Fly, to which the navigation returns. */
    this.flight = this.address.view === "fly" ? this.address : NOTHING;
    /** Whether the history entry is older than the address. */
    this.stale = false;
    this.timer = 0;
    window.addEventListener("popstate", () => this.show(read(location)));
    // A link leaves this entry.
    window.addEventListener("click", () => this.write(), { capture: true });
    window.addEventListener("pagehide", () => this.write());
  }

  /** Goes to another address with a new history entry. @param {Partial<Address>} address */
  go(address) {
    const next = { ...NOTHING, ...address };
    this.write();
    if (linkOf(next).href !== linkOf(this.address).href) history.pushState(null, "", linkOf(next));
    this.show(next);
  }

  get bare() {
    return linkOf(this.address).search === "";
  }

  /**
   * Writes the flights that were started: a new history entry, unless they only complete the present address.
   * @param {Partial<Address>} flown @param {boolean} entry Forces a new entry.
   */
  flies(flown, entry = false) {
    const { lesson } = this.address;
    const next = { ...NOTHING, lesson, ...flown };
    this.write();
    if (!entry && says(this.address, next)) history.replaceState(null, "", linkOf(next));
    else history.pushState(null, "", linkOf(next));
    this.address = this.flight = next;
  }

  /** Updates the moment and the moves of the same flight, without a new entry. @param {Partial<Address>} now */
  moment(now) {
    if (Object.keys(now).every((name) => this.address[name] === now[name])) return;
    this.address = this.flight = { ...this.address, ...now };
    this.stale = true;
    // At once, unless the entry has just changed: a reload shows the moment that the visitor saw.
    if (!this.timer) this.write();
  }

  write() {
    clearTimeout(this.timer);
    this.timer = 0;
    if (!this.stale) return;
    this.stale = false;
    this.timer = setTimeout(() => this.write(), PAUSE);
    history.replaceState(null, "", linkOf(this.address));
  }

  show(address) {
    // A pending update of the entry that Back has left is dropped.
    this.stale = false;
    this.address = address;
    if (address.view === "fly") this.flight = address;
    this.emit("address", address);
  }
}

export const NOTHING = {
  view: "fly",
  task: null,
  seed: null,
  profile: null,
  pilots: [],
  episode: null,
  file: null,
  ghost: null,
  step: null,
  fork: null,
  actions: null,
  of: null,
  selected: null,
  ended: null,
  lesson: null,
  unread: [],
};

/** Whether these flights match an address, whose missing parts match everything. */
export function says(address, flown) {
  const open = (name) => address[name] === null || address[name].length === 0;
  const same = (name) => String(address[name]) === String(flown[name]);
  return (
    address.view === flown.view &&
    ["task", "seed", "pilots"].every((name) => open(name) || same(name)) &&
    ["profile", "episode", "file", "ghost", "fork"].every(same)
  );
}

/** The parts that are counts, with their least values. */
const LEAST = { step: 0, fork: 0, lesson: 1, selected: 1, ended: 0 };

/** @returns {Address} */
function read({ search }) {
  const link = new URLSearchParams(search);
  const unread = [];
  const ignore = (name, why = "") => unread.push(`${name}=${shortened(link.get(name) ?? "")}${why}`);
  const number = (name) => {
    const text = link.get(name) || null;
    // Numbers beyond JavaScript's integers stay too large; the server rejects them with a message.
    return /^-?\d+$/.test(text ?? "") ? Math.min(Number(text), 2 ** 53) : text;
  };
  /** @type {Address} */
  const found = { ...NOTHING, unread, seed: number("seed") };
  const view = link.get("view") ?? found.view;
  if (VIEWS.has(view)) found.view = view;
  else ignore("view");
  for (const name of ["task", "profile", "episode", "file", "ghost", "actions", "of"]) found[name] = link.get(name) || null;
  // Split before decoding: names may contain commas.
  found.pilots = (search.match(/[?&]pilots?=([^&]*)/)?.[1] ?? "").split(",").filter(Boolean).map(decoded);
  for (const [name, least] of Object.entries(LEAST)) {
    const value = number(name);
    if (typeof value === "number" && value >= least) found[name] = value;
    else if (value !== null) ignore(name);
  }
  const before = unread.length;
  const { fork, of } = found;
  const moves = found.actions ?? "";
  if (/[^UDLRW]/.test(moves)) ignore("actions", " (moves are U, D, L, R and W)");
  else if (moves.length < fork) ignore("actions", ` (fork=${fork} needs all ${fork} moves from step 0)`);
  if (of === null ? fork !== null : readProvenance(of) === null) ignore("of");
  // Without its step, a fork has no moves: they would be the visitor's own.
  const isForkless = unread.length > before || (link.get("fork") && fork === null);
  return isForkless ? { ...found, fork: null, actions: null, of: null } : found;
}

/** @param {Partial<Address>} address */
export const copyLink = (address) => copyText(linkOf(address).href, "Link copied.");

/** The link to an address. @param {Partial<Address>} address */
export function linkOf(address) {
  const { view, pilots, ...rest } = { ...NOTHING, ...address };
  const parts = view === "fly" ? [] : [`view=${view}`];
  const say = (name) => {
    if (rest[name] !== null && rest[name] !== "") parts.push(`${name}=${encodeURIComponent(rest[name])}`);
  };
  for (const name of ["episode", "file", "task", "seed"]) say(name);
  if (pilots.length) parts.push(`${pilots.length > 1 ? "pilots" : "pilot"}=${pilots.map(encodeURIComponent).join(",")}`);
  for (const name of ["profile", "ghost", "fork", "of", "actions", "step", "selected", "ended", "lesson"]) say(name);
  const url = new URL(document.baseURI);
  url.search = parts.join("&");
  url.hash = "";
  return url;
}
