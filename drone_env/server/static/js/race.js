// The live flights of this page: requests to the server, and its messages.
import { Emitter, recall, remember } from "./base.js";
import { toast } from "./dom.js";
import { sentence } from "./format.js";
import { NOTHING } from "./router.js";
import { worldOf } from "./stage.js";
import { nameOf, UNLISTED } from "./today.js";
import { readProvenance, Track, writeProvenance } from "./track.js";

/** Key of the ids of the last flights that this visitor has flown by hand, and how many are kept. */
export const FLOWN = "drone-env-flown";
const KEPT = 200;
/** Actions as links write them. */
const LETTERS = { U: "UP", D: "DOWN", L: "LEFT", R: "RIGHT", W: "WAIT" };

/**
 * The states, and what leads from one to another. idle: nothing is asked of the server. playing: it flies the pilots.
 * starting: a start waits for its answer, or for the connection. launching: likewise, and then the pilots fly.
 * interrupted: the connection is lost while they fly. attaching: a new connection asks for the same flights. returning:
 * likewise, and then the pilots fly on.
 */
/** @type {Partial<Record<RaceCause, RaceState>>} */
const START = { start: "starting", launch: "launching" };
/** @type {Partial<Record<RaceCause, RaceState>>} */
const ANSWER = { flights: "idle", refused: "idle" };
/** The next state after each cause; a cause that is not listed changes nothing. @type {Record<RaceState, Partial<Record<RaceCause, RaceState>>>} */
const NEXT = {
  idle: { ...START, attach: "attaching", plays: "playing", lost: "idle" },
  playing: { ...START, plays: "playing", pauses: "idle", flights: "idle", lost: "interrupted" },
  starting: { ...START, ...ANSWER, rest: "idle" },
  launching: { ...START, ...ANSWER, rest: "idle", pause: "starting" },
  interrupted: { pause: "idle", attach: "returning" },
  attaching: { ...START, ...ANSWER },
  returning: { ...START, ...ANSWER, pause: "attaching" },
};

/**
 * `setup` describes the flights as an `Address` of router.js.
 *
 * Events: "setup" other flights are chosen, "playing" the state or the speed changes, "refused" (text), "begun" the
 * server has opened the flights, "ended" (track) a flight has ended and is stored.
 */
export class Race extends Emitter {
  /** @param {Context} context */
  constructor(context) {
    super();
    this.context = context;
    this.stage = context.stage;
    /** @type {Partial<Address>} */
    this.setup = { view: "fly", task: context.tasks[0].short_name, seed: null, profile: null, pilots: [] };
    /** The flights that the server runs for this page. @type {Track[]} */
    this.tracks = [];
    /** @type {RaceState} */
    this.state = "idle";
    this.number = 0;
    /** Finished flights that are shown beside them. @type {Track[]} */
    this.beside = [];
    /** Ids of the pilots of the newest start. @type {string[]} */
    this.flown = [];
    /** What a start replaces until it is answered. */
    this.left = {};
    /** The visitor's moves until it is answered. @type {string[]} */
    this.moves = [];
    const { live } = context;
    live.on("state", ({ state }) => (state === "open" ? this.resume() : this.turn("lost")));
    live.on("flights", (message) => this.begin(message));
    live.on("frames", ({ frames }) => this.move(frames));
    live.on("values", (message) => this.value(message));
    live.on("undone", (message) => this.undone(message));
    live.on("helped", (message) => this.helped(message));
    live.on("playing", ({ playing }) => this.turn(playing ? "plays" : "pauses"));
    live.on("ended", ({ flight, episode }) => this.ended(this.tracks[flight], episode));
    live.on("error", (message) => this.refused(message));
    // A closed page releases its sessions for other visitors.
    window.addEventListener("pagehide", ({ persisted }) => persisted || live.send({ type: "end" }));
  }

  /** Goes to the next state. @param {RaceCause} cause */
  turn(cause) {
    const next = NEXT[this.state][cause];
    if (!next) return;
    this.state = next;
    this.stage.flying = this.playing;
    this.stage.tell("cursor");
    this.emit("playing");
  }

  get playing() {
    return this.state === "playing";
  }

  get starting() {
    return this.state === "starting" || this.state === "launching";
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
    return mine && mine.steps > (mine === this.forked ? this.setup.fork : 0) ? mine : null;
  }

  /** Whether keys fly: in the flight that is shown, or in one that is starting. */
  get byHand() {
    return this.starting ? this.flown.includes(this.person.id) : this.mine !== null;
  }

  /** The flight that is selected unless the address says otherwise. */
  get front() {
    return this.forked ?? this.tracks[this.human] ?? this.beside[0] ?? this.tracks[0];
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

  get automatic() {
    return this.tracks.some(({ automatic, done }) => automatic && !done);
  }

  /** The task of the setup. */
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
   * Starts other flights: `change` replaces parts of the present setup; forks and moments are dropped.
   * @param {Partial<Address>} change @param {StartOptions} how
   */
  start(change = {}, how = {}) {
    const { play = false, beside = [], flown = null, moves = [] } = how;
    const { task, seed, profile, pilots } = this.setup;
    const { live } = this.context;
    if (live.state !== "open" && this.tracks.length) {
      toast("The server is away. Your flight is kept; start another one when the server is back.");
      this.emit("setup");
      return;
    }
    // If the server rejects the start, the present flights stay, paused.
    if (this.tracks.length) live.send({ type: "pause" });
    if (!this.starting) this.left = { setup: this.setup, beside: this.beside, flown: this.flown };
    this.setup = this.complete({ task, seed, profile, pilots, ...change });
    this.beside = beside;
    this.flown = flown ?? this.setup.pilots;
    this.moves = [...moves];
    this.turn(play ? "launch" : "start");
    this.emit("setup");
    if (live.state === "open") this.send();
  }

  send() {
    const { task, seed, profile, fork, actions, of, step, ended } = this.setup;
    const request = { task, seed, reward_profile: profile, pilots: this.flown, name: nameOf() };
    // The visitor's own flight continues as a fork in which all moves are the visitor's.
    if (fork !== null || of !== null)
      request.fork = { actions: [...(actions ?? "")].map((one) => LETTERS[one] ?? one), step: fork ?? 0, of: readProvenance(of) };
    if (ended ?? step) request.step = ended ?? step;
    this.context.live.send({ type: "start", number: ++this.number, ...request });
  }

  /** Forks a flight at a step: `pilot` flies on beside it, starting with `action`. */
  fork(track, step, { pilot = this.person.id, action = null } = {}) {
    const { world } = this.stage;
    // A fork of a fork is shown beside the flights of the first fork.
    const kept = (one) => one !== track && (one.past || one.forkedAt === null);
    const left = track === this.forked ? this.stage.tracks.filter(kept) : [track];
    // Automatic pilots repeat their flights when the link is opened; any other flight must be stored.
    const again = left.filter((one) => one.automatic && !one.past && one.forkedAt === null);
    const along = again.filter((one) => !one.done);
    const stored = left.find((one) => !again.includes(one));
    const idsOf = (tracks) => [...tracks.map((one) => one.pilot), pilot];
    const change = {
      task: world.task.short_name,
      seed: world.seed,
      profile: world.reward_profile,
      pilots: idsOf([...again.filter((one) => one.done), ...along]),
      episode: stored?.episode?.id ?? null,
      fork: step,
      actions: track.lettersTo(step),
      of: writeProvenance(track.provenance),
    };
    const play = this.context.pilot(pilot).automatic;
    const beside = [...new Set([...left, track])].filter((one) => !along.includes(one));
    this.start(change, { play, beside, flown: idsOf(along), moves: action ? [action] : [] });
  }

  play(speed = this.stage.clock.speed) {
    if (this.automatic) this.context.live.send({ type: "play", speed });
  }

  pause() {
    this.turn("pause");
    if (this.playing) this.context.live.send({ type: "pause" });
  }

  step() {
    if (!this.playing && this.tracks.some(({ done }) => !done)) this.context.live.send({ type: "step" });
  }

  setSpeed(speed) {
    this.stage.clock.speed = speed;
    if (this.playing) this.play(speed);
    else this.emit("playing");
  }

  /** Flies one move of the visitor; paused pilots take one step each. */
  fly(direction) {
    if (!this.byHand) return;
    if (this.starting) {
      this.moves.push(direction);
      return;
    }
    const flight = this.human;
    this.stage.clock.seek(this.stage.clock.newest());
    this.context.live.send({ type: "fly", flight, direction });
    if (this.automatic && !this.playing) this.context.live.send({ type: "step" });
  }

  undo() {
    if (this.begun) this.context.live.send({ type: "undo", flight: this.human });
  }

  /** Shows values to a visitor who flies; the record notes it. */
  help() {
    if (this.mine && !this.mine.provenance.values_used) this.context.live.send({ type: "help", flight: this.human });
  }

  resume() {
    if (this.starting) this.send();
    // Finished flights need no session.
    if (this.starting || this.tracks.every(({ done }) => done)) return;
    this.turn("attach");
    const sessions = this.tracks.map(({ opening }) => opening.session);
    this.context.live.send({ type: "attach", number: ++this.number, sessions });
  }

  begin({ flights, number }) {
    // The answer to `end`: the page is closing.
    if (!flights.length) return;
    const { state, starting } = this;
    const wasShown = this.shown || starting;
    this.tracks = flights.map((flown) => new Track(this.context, flown, true));
    const { fork, step, selected: chosen } = this.setup;
    if (fork !== null) this.tracks.at(-1).forkedAt = fork;
    for (const track of this.beside) track.live = false;
    // An answer to an older request does not change the setup.
    const newest = number === this.number;
    if (newest) {
      const { seed, short_name } = flights[0].opening;
      const rest = this.setup.pilots.slice(0, this.setup.pilots.length - this.flown.length);
      const pilots = [...rest, ...this.tracks.map(({ pilot }) => pilot)];
      this.setup = { ...this.setup, seed, task: short_name, pilots };
      this.turn("flights");
    }
    const { clock, selected } = this.stage;
    // After a lost connection, the page shows what it showed before.
    const attached = state === "attaching" || state === "returning";
    if (wasShown && attached) this.show(clock.following ? null : clock.cursor, selected);
    else if (wasShown) this.show(step, chosen - 1);
    this.emit("setup");
    this.emit("begun");
    if (!newest) return;
    // A fork always shows values.
    if (this.setup.fork !== null) this.help();
    const moves = this.moves.splice(0);
    if (state === "launching" || state === "returning") this.play();
    for (const direction of moves) this.fly(direction);
  }

  /** Puts these flights on the stage, at their newest step by default. */
  show(step = null, selected = null) {
    const tracks = [...this.beside, ...this.tracks];
    this.stage.show(worldOf(this.tracks[0].opening, this.context.tasks), tracks, {
      step: step ?? Math.max(...this.tracks.map((track) => track.steps)),
      selected: tracks[selected] ? selected : tracks.indexOf(this.front),
      followed: this.tracks,
    });
  }

  move(frames) {
    for (const { flight, frame } of frames) {
      const track = this.tracks[flight];
      track?.frames.push(frame);
      if (track) this.stage.changed(track);
      // The race goes on without the visitor.
      if (flight === this.human && frame.done && this.automatic) this.play();
    }
  }

  undone({ flight, step, values_used, undo_used }) {
    const track = this.tracks[flight];
    if (track.plain) toast(UNLISTED);
    Object.assign(track.provenance, { values_used, undo_used });
    track.frames.length = step + 1;
    this.stage.changed(track);
    this.stage.clock.seek(this.stage.clock.newest());
  }

  helped({ flight, frame, values_used, undo_used }) {
    const track = this.tracks[flight];
    Object.assign(track.provenance, { values_used, undo_used });
    track.frames[frame.step] = frame;
    this.stage.changed(track);
  }

  value({ flight, values, regrets }) {
    const track = this.tracks[flight];
    if (!track) return;
    values.forEach((value, i) => track.frames[i] && Object.assign(track.frames[i], { value, regret: regrets[i] }));
    this.stage.changed(track);
  }

  ended(track, episode) {
    if (!track) return;
    track.episode = episode;
    track.live = false;
    const flown = (recall(FLOWN) ?? "").split(" ");
    if (!track.automatic && flown.includes(episode.id)) track.called = this.person.name;
    else if (!track.automatic && !track.brought) remember(FLOWN, [episode.id, ...flown].slice(0, KEPT).join(" "));
    this.stage.changed(track);
    this.emit("ended", track);
  }

  refused({ code, detail }) {
    const { state, starting, beside, flown, moves } = this;
    if (!starting && code === "session_gone") {
      toast("The server has ended this flight. It starts again.");
      const play = state === "playing" || state === "returning";
      this.start({ ...this.setup, ...this.linkParts }, { play, beside, flown, moves });
      return;
    }
    this.turn("refused");
    // A key may arrive after the end of the flight: ignored.
    if ((state === "idle" || state === "playing") && code === "wrong_moment") return;
    if (starting) {
      // Without flights that stay, the next start is one that every visitor can fly.
      const known = { ...NOTHING, task: (this.task ?? this.context.tasks[0]).short_name };
      Object.assign(this, this.tracks.length ? this.left : { setup: known });
      this.emit("setup");
    }
    this.emit("refused", sentence(detail));
  }
}
