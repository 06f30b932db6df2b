// The flights that this page starts: those of pilots, which the server has flown to their ends, and the visitor's own.
import { ApiError, tried } from "./api.js";
import { Emitter, recall, remember } from "./base.js";
import { toast } from "./dom.js";
import { sentence } from "./format.js";
import { NOTHING } from "./router.js";
import { worldOf } from "./stage.js";
import { nameOf } from "./today.js";
import { readProvenance, Track, unweighed, writeProvenance } from "./track.js";

/** Key of the ids of the last flights that this visitor has flown by hand, and how many are kept. */
export const FLOWN = "drone-env-flown";
const KEPT = 200;
/** Actions as links write them. */
const LETTERS = { U: "UP", D: "DOWN", L: "LEFT", R: "RIGHT", W: "WAIT" };

/** An error in the words of the page: it has no bodies of requests. @param {Error} error */
const worded = ({ message }) => sentence(message.replace("body.seed", "the number of the map").replace(/body\./g, ""));

/**
 * `setup` describes the flights as an `Address` of router.js.
 *
 * Events: "setup" other flights are chosen, "refused" (text), "begun" the server has opened the flights, "ended" (track)
 * a flight has ended and is stored.
 */
export class Race extends Emitter {
  /** @param {Context} context */
  constructor(context) {
    super();
    this.context = context;
    this.stage = context.stage;
    const setup = { view: "fly", task: context.tasks[0].short_name, seed: null, profile: null, pilots: [] };
    /** The last start that was answered. @type {Start} */
    this.started = { setup, beside: [], moves: [] };
    /** The start that waits for its answer, or null. @type {Start|null} */
    this.starting = null;
    /** The flights that this page has started. @type {Track[]} */
    this.tracks = [];
    this.stage.on("frames", () => this.noteEnds());
    // A closed page releases its sessions for other visitors.
    window.addEventListener("pagehide", ({ persisted }) => persisted || this.leave(this.tracks));
  }

  /** The newest start. */
  get newest() {
    return this.starting ?? this.started;
  }

  get setup() {
    return this.newest.setup;
  }

  /** Whether the stage shows these flights, not a stored one. */
  get shown() {
    return this.tracks.length > 0 && this.tracks.every((track) => this.stage.tracks.includes(track));
  }

  get human() {
    return this.tracks.findIndex(({ automatic }) => !automatic);
  }

  get forked() {
    return this.setup.fork === null ? null : (this.tracks.at(-1) ?? null);
  }

  /** The flight by hand while it is shown, or null. */
  get own() {
    return (this.shown && this.tracks[this.human]) || null;
  }

  /** The visitor's flight while it is shown and unfinished, or null. */
  get mine() {
    return this.own?.done === false ? this.own : null;
  }

  get atHand() {
    const { track, clock } = this.stage;
    return this.mine !== null && track === this.mine && clock.cursor >= track.steps;
  }

  /** The visitor's flight once it contains a move that another start would discard, or null. */
  get begun() {
    const { mine } = this;
    return mine && mine.flown > (mine === this.forked ? this.setup.fork : 0) ? mine : null;
  }

  /** Whether keys fly: in the flight that is shown, or in one that is starting. */
  get byHand() {
    return this.starting ? this.setup.pilots.includes(this.person.id) : this.mine !== null;
  }

  /** The flight that is selected unless the address says otherwise. */
  get front() {
    return this.forked ?? this.tracks[this.human] ?? this.started.beside[0] ?? this.tracks[0];
  }

  /** The part of the address from which a fork or the visitor's flight continues, and the choice among the flights. */
  get linkParts() {
    if (!this.shown) return {};
    const { selected, clock, over } = this.stage;
    // The address of a stored flight needs no moves.
    const track = this.forked ?? (this.setup.episode ? undefined : this.tracks[this.human]);
    const actions = track ? track.lettersTo(track.steps) : null;
    const flown = over ? clock.end() : clock.newest();
    const chosen = {
      actions,
      selected: this.stage.track === this.front ? null : selected + 1,
      // How far the pilots have flown, if neither the moves nor the step say it.
      ended: (over || actions) && flown > (actions?.length || clock.cursor) ? flown : null,
    };
    if (this.forked) return chosen;
    // A finished flight is not credited to the visitor who opens its link.
    const by = track && { ...track.provenance, ...(!track.done && { person: null }) };
    return { ...chosen, of: track && (track.steps || !track.plain) ? writeProvenance(by) : null };
  }

  get person() {
    return this.context.pilots.find(({ automatic }) => !automatic);
  }

  get task() {
    return this.context.task(this.setup.task);
  }

  flies(id, task) {
    return !task || this.context.pilot(id).tasks.includes(task.id);
  }

  able(task) {
    return this.context.pilots.filter(({ id, automatic }) => automatic && this.flies(id, task)).map(({ id }) => id);
  }

  /** An address whose missing parts come from the present flights. @param {Partial<Address>} address */
  complete(address) {
    const { lesson, ...rest } = { ...NOTHING, ...address };
    const { task, pilots } = rest;
    const known = this.context.task(task ?? this.setup.task) ?? this.context.tasks[0];
    const named = pilots.length ? pilots : this.setup.pilots.filter((id) => this.flies(id, known));
    return {
      ...rest,
      view: "fly",
      task: task === null || this.context.task(task) ? known.short_name : task, // the server rejects an unknown one
      pilots: named.length ? named : this.able(known).slice(0, 1),
    };
  }

  /**
   * Starts other flights: `change` replaces parts of the present setup; forks and moments are dropped. `play`: at once.
   * @param {Partial<Address>} change @param {Partial<Start> & {play?: boolean}} how
   */
  async start(change = {}, { play = false, beside = [], moves = [] } = {}) {
    const { task, seed, profile, pilots } = this.setup;
    // If the server rejects the start, the present flights stay, paused.
    this.stage.clock.stop();
    const setup = this.complete({ task, seed, profile, pilots, ...change });
    const start = (this.starting = { setup, beside, moves: [...moves] });
    this.emit("setup");
    const { api, server } = this.context;
    /** @type {Track[]} */
    let tracks = [];
    try {
      const { flights } = await (this.tracks.length ? api : server).post("flights", this.request());
      tracks = this.tracksOf(flights);
      // A link to a later moment shows that moment first.
      if (tracks.some(({ until }) => until)) await Promise.all(tracks.map((track) => this.load(track)));
      if (this.starting === start) this.begin(tracks, play);
      else this.leave(tracks);
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      this.leave(tracks);
      if (this.starting === start) this.refused(error);
    }
  }

  request() {
    const { task, seed, profile, fork, actions, of } = this.setup;
    // Pilots whose flights stay fly on.
    const pilots = this.setup.pilots.slice(this.staying().length);
    const request = { task, seed, reward_profile: profile, pilots, name: nameOf() };
    // The visitor's own flight continues as a fork in which all moves are the visitor's.
    if (fork === null && of === null) return request;
    const flown = [...(actions ?? "")].map((one) => LETTERS[one] ?? one);
    return { ...request, fork: { actions: flown, step: fork ?? 0, of: readProvenance(of) } };
  }

  /** Gives up a start that waits for its answer, and pauses. */
  rest() {
    this.stage.clock.stop();
    this.starting = null;
  }

  /** Ends the sessions of flights, and the requests for them. @param {Track[]} tracks */
  leave(tracks) {
    for (const { opening, loading } of tracks) {
      loading.abort();
      if (opening.session) this.context.api.end(opening.session);
    }
  }

  /** The flights of pilots that stay beside a fork. A link to it contains them. */
  staying({ setup, beside } = this.newest) {
    return setup.fork === null ? [] : beside.filter((track) => track.again);
  }

  /** Leaves a flight at a step for a flight of the visitor, which is shown beside it. @param {string|null} action The first one. */
  fork(track, step, action) {
    const { world, tracks } = this.stage;
    // A fork of a fork is also beside what the first one left.
    const beside = [...(track === this.forked ? tracks.filter(({ forkedAt }) => forkedAt === null) : []), track];
    const stored = beside.find((one) => one.episode && !one.again);
    const change = {
      task: world.task.short_name,
      seed: world.seed,
      profile: world.reward_profile,
      pilots: [...beside.filter((one) => one.again).map(({ pilot }) => pilot), this.person.id],
      episode: stored?.episode.id ?? null,
      fork: step,
      actions: track.lettersTo(step),
      of: writeProvenance(track.provenance),
    };
    this.start(change, { beside, moves: action ? [action] : [] });
  }

  /** Flies one move of the visitor, or takes one back; paused pilots take one step each. */
  fly(move) {
    if (!this.byHand) return;
    if (this.starting) this.starting.moves.push(move);
    else {
      this.stage.clock.seek(this.stage.clock.newest());
      this.change(move);
    }
  }

  /** Shows values to a visitor who flies; the record notes it. */
  help() {
    if (this.mine && !this.mine.provenance.values_used) this.change("VALUES");
  }

  /** Changes the visitor's flight, after the changes before. @param {string} change */
  async change(change) {
    const track = this.tracks[this.human];
    track.pending.push(change);
    if (track.pending.length > 1) return;
    // Keys may be pressed after the end of the flight, or when no move is left to take back.
    const fits = (next) => next !== "UNDO" || track.steps > (track.forkedAt ?? 0);
    for (; track.pending.length && !track.done && this.tracks.includes(track); track.pending.shift())
      if (fits(track.pending[0])) await this.send(track, track.pending[0]);
    track.pending = [];
  }

  async send(track, change) {
    const { clock } = this.stage;
    try {
      const { session } = track.opening;
      const answer = await this.context.server.post("flights/change", { version: track.version, change }, { session });
      const { frame, version, values_used, undo_used, episode } = answer;
      if (!this.tracks.includes(track)) return;
      if (change === "UNDO" && track.plain) toast("Flights with Undo are not listed and not kept as your best.");
      Object.assign(track, { version, stored: episode });
      Object.assign(track.provenance, { values_used, undo_used });
      track.frames.splice(frame.step, Infinity, unweighed(frame));
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      if (this.tracks.includes(track)) this.unmade(track, error);
      return;
    }
    this.stage.changed(track);
    this.weigh(track);
    if (!this.shown || change === "VALUES") return;
    clock.seek(clock.newest());
    if (!this.stage.goesOn || change === "UNDO") return;
    // The race goes on without the visitor.
    if (track.done) clock.play();
    else if (!clock.playing) this.stage.flyOn();
  }

  unmade(track, error) {
    const moves = track.pending.splice(0);
    if (error.code !== "session_gone") {
      this.emit("refused", worded(error));
      return;
    }
    track.opening.session = null;
    toast("The server has ended this flight. It starts again.");
    const { setup, beside } = this.newest;
    this.start({ ...setup, ...this.linkParts }, { play: this.shown && this.stage.clock.playing, beside, moves });
  }

  tracksOf(flights) {
    const { fork, of, step, ended, actions } = this.setup;
    const brought = fork === null && of === null ? 0 : (actions ?? "").length;
    const tracks = flights.map((flown) => new Track(this.context, flown, true));
    // Pilots beside a fork or the visitor's flight have flown as far.
    for (const track of tracks) if (track.steps === 0) track.until = Math.max(brought, ended ?? step ?? 0);
    if (fork !== null) tracks.at(-1).forkedAt = fork;
    return tracks;
  }

  /** Loads the flight of a pilot, which the page plays. */
  async load(track) {
    if (!track.coming) return;
    const { task, seed, reward_profile } = track.opening;
    const request = { task, seed, reward_profile, pilot: track.pilot };
    const answer = await this.context.server.post("flights/agent", request, { signal: track.loading.signal });
    const { following } = this.stage.clock;
    track.fill(answer);
    if (!this.tracks.includes(track)) return;
    this.stage.changed(track);
    if (this.shown && following) this.stage.clock.seek(this.stage.clock.newest());
    this.weigh(track);
  }

  begin(tracks, play) {
    const { setup, beside, moves } = this.starting;
    const { fork, step, selected: chosen } = setup;
    const staying = this.staying();
    this.started = { setup, beside: beside.filter((track) => !staying.includes(track)), moves };
    this.starting = null;
    this.leave(this.tracks.filter((track) => !staying.includes(track)));
    this.tracks = [...staying, ...tracks];
    for (const track of this.started.beside) track.live = false;
    const { seed, task } = tracks[0].opening;
    const { short_name } = this.context.task(task);
    Object.assign(setup, { seed, task: short_name, pilots: this.tracks.map(({ pilot }) => pilot) });
    this.show(step, chosen - 1);
    this.emit("setup");
    this.emit("begun");
    this.noteEnds();
    for (const track of tracks) {
      if (!track.coming) this.weigh(track);
      else
        this.load(track).catch((error) => {
          track.coming = false;
          this.stage.changed(track);
          if (this.tracks.includes(track)) this.emit("refused", worded(error));
        });
    }
    // A fork always shows values.
    if (fork !== null) this.help();
    if (play) this.stage.clock.play();
    for (const change of moves) this.change(change);
  }

  /** Puts these flights on the stage, at their newest step by default. */
  show(step = null, selected = null) {
    const tracks = [...this.started.beside, ...this.tracks];
    this.stage.show(worldOf(this.tracks[0].opening, this.context.tasks), tracks, {
      step: step ?? Math.max(...this.tracks.map((track) => track.steps)),
      selected: tracks[selected] ? selected : tracks.indexOf(this.front),
      followed: this.tracks,
    });
  }

  /** Loads the best score still possible at each step, unless it is hidden; too large maps do without. */
  async weigh(track) {
    const isLive = () => this.tracks.includes(track) && !track.done && !track.secret;
    const lacks = () => isLive() && track.all.some(({ value }) => value === null);
    if (track.weighing) return;
    track.weighing = true;
    while (lacks()) {
      const { all: frames, opening } = track;
      const actions = frames.slice(1).map(({ action }) => action);
      const flight = { task: opening.task, seed: opening.seed, actions, only: "moves" };
      const answer = await tried(() => this.context.server.post("values", flight));
      if (!answer?.along) return;
      const [optimum] = answer.along;
      answer.along.forEach((value, i) => Object.assign(frames[i], { value, regret: optimum - value }));
      this.stage.changed(track);
    }
    track.weighing = false;
  }

  noteEnds() {
    for (const track of this.tracks) if (track.live && track.done) this.ended(track);
  }

  ended(track) {
    const id = track.stored;
    track.episode = { id };
    track.live = false;
    const flown = (recall(FLOWN) ?? "").split(" ");
    if (!track.automatic && flown.includes(id)) track.called = this.person.name;
    else if (!track.automatic && !track.brought) remember(FLOWN, [id, ...flown].slice(0, KEPT).join(" "));
    this.stage.changed(track);
    this.emit("ended", track);
  }

  refused(error) {
    // Without flights that stay, the next start is one that every visitor can fly.
    if (!this.tracks.length) this.started.setup = { ...NOTHING, task: (this.task ?? this.context.tasks[0]).short_name };
    this.starting = null;
    this.emit("setup");
    if (error.status) this.emit("refused", worded(error));
    else toast("The server is away. Your flight is kept; start another one when the server is back.");
  }
}
