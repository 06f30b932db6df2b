// The live flights of this page: what is asked of the server, and what it tells.
import { Emitter } from "./base.js";
import { toast } from "./dom.js";
import { NOTHING } from "./router.js";
import { worldOf } from "./stage.js";
import { Track } from "./track.js";

const PATIENCE = 2500;
/** Actions as links write them. */
const LETTERS = { U: "UP", D: "DOWN", L: "LEFT", R: "RIGHT", W: "WAIT" };
const lettersOf = (actions) => actions.map((action) => action[0]).join("");

/**
 * What is flown is kept as the address says it: see `Address` of router.js.
 *
 * Events: "setup" other flights were chosen, "playing" started, paused or another speed, "refused" (text), "begun" the server
 * flies what was chosen, "ended" (track) one has ended and is stored.
 */
export class Fleet extends Emitter {
  /** @param {import("./context.js").Context} context */
  constructor(context) {
    super();
    this.context = context;
    this.stage = context.stage;
    /** @type {Partial<import("./router.js").Address>} */
    this.setup = { view: "fly", task: context.tasks[0].short_name, seed: null, profile: null, pilots: [] };
    /** The flights that the server flies for us. @type {Track[]} */
    this.tracks = [];
    this.playing = false;
    this.asked = null;
    this.number = 0;
    this.how = { play: false, beside: [], flown: null, after: null, moves: [] };
    this.waiting = false;
    this.slow = 0;
    const { live } = context;
    live.on("state", ({ state }) => (state === "open" ? this.resume() : this.lost()));
    live.on("flights", (message) => this.begin(message));
    live.on("frames", ({ frames }) => this.move(frames));
    live.on("values", (message) => this.value(message));
    live.on("undone", (message) => this.undone(message));
    live.on("helped", (message) => this.helped(message));
    live.on("playing", ({ playing }) => this.setPlaying(playing));
    live.on("ended", ({ flight, episode }) => this.ended(this.tracks[flight], episode));
    live.on("error", (message) => this.refused(message));
    // A page that is closed gives its sessions back: nobody could attach to them, and they take the room of others.
    window.addEventListener("pagehide", ({ persisted }) => persisted || live.send({ type: "end" }));
  }

  get over() {
    return this.tracks.length > 0 && this.tracks.every((track) => track.done);
  }

  /** Whether these flights are on the stage, not one of the past. */
  get shown() {
    return this.tracks.length > 0 && this.tracks.every((track) => this.stage.tracks.includes(track));
  }

  /** The number of the flight that the visitor flies; -1 for none. */
  get human() {
    return this.tracks.findIndex(({ pilot }) => !this.pilot(pilot).automatic);
  }

  /** The flight that has left another one's way; null for none. */
  get forked() {
    return this.setup.fork === null ? null : (this.tracks.at(-1) ?? null);
  }

  /** The visitor's own flight while it goes on and is shown; null where there is none. */
  get mine() {
    const track = this.tracks[this.human];
    return track && this.shown && !track.done ? track : null;
  }

  /** Whether what is looked at is the visitor's own flight, where it goes on. */
  get atHand() {
    const { track, clock } = this.stage;
    return this.mine !== null && track === this.mine && clock.cursor >= track.steps;
  }

  /** The same once he has flown in it, which is lost where another begins. */
  get own() {
    const { mine } = this;
    return mine && mine.steps > (mine === this.forked ? this.setup.fork : 0) ? mine : null;
  }

  /** Whether the visitor's moves are flown: in the flight that is shown, or in one that is on its way. */
  get byHand() {
    return this.asked === "start" ? this.how.flown.includes(this.person.id) : this.mine !== null;
  }

  /** What the address says so that a fork, or the visitor's own flight, goes on where it was left: its moves, and whose they are. */
  get told() {
    if (!this.shown) return {};
    const track = this.forked ?? this.mine;
    if (!track) return { actions: null, of: null };
    const { by, pilot, steps } = track;
    const actions = lettersOf(track.actionsTo(steps));
    if (this.forked) return { actions };
    return { actions, of: steps || by !== pilot ? by : null };
  }

  /** The pilot who is the visitor. */
  get person() {
    return this.context.pilots.find(({ automatic }) => !automatic);
  }

  /** Whether a pilot that flies by itself has not ended. */
  get automatic() {
    return this.tracks.some(({ pilot, done }) => !done && this.pilot(pilot).automatic);
  }

  /** @returns {Object} What the server tells of a pilot; a stand-in where it does not know it. */
  pilot(id) {
    const unknown = { id, name: id, summary: "", automatic: true, tasks: [], colour: "other" };
    return this.context.pilots.find((pilot) => pilot.id === id) ?? unknown;
  }

  /** How a pilot is called and coloured. */
  look(id) {
    const { name, colour } = this.pilot(id);
    return { name, colour: `--pilot-${colour}` };
  }

  task(name = this.setup.task) {
    return this.context.tasks.find((task) => task.short_name === name || task.id === name || task.grader === name);
  }

  /** Whether a pilot can fly a task. */
  flies(id, task = this.task()) {
    return !task || this.pilot(id).tasks.includes(task.id);
  }

  /** Ids of all who fly a task by themselves, as the server lists them: the visitor's own network first. */
  able(task = this.task()) {
    return this.context.pilots.filter(({ id, automatic }) => automatic && this.flies(id, task)).map(({ id }) => id);
  }

  /** What an address asks for, filled up with what is flown now. @param {import("./router.js").Address} address */
  asks(address) {
    const { lesson, ...asked } = { ...NOTHING, ...address };
    const { task, pilots } = asked;
    const known = this.task(task ?? this.setup.task) ?? this.context.tasks[0];
    const named = pilots.length ? pilots : this.setup.pilots.filter((id) => this.flies(id, known));
    return {
      ...asked,
      view: "fly",
      task: task === null || this.task(task) ? known.short_name : task, // the server says what is wrong with another
      pilots: named.length ? named : this.able(known).slice(0, 1),
    };
  }

  /**
   * Starts other flights: what is named in `change` is new, the rest as it was; forks and moments are not kept.
   *
   * @param {{play?: boolean, beside?: Track[], flown?: string[], after?: () => void}} how Whether to play at once, flights of
   *   the past to show beside them, those pilots of the setup who are still to be flown, what to do then, and the visitor's
   *   moves until then.
   */
  start(change = {}, { play = false, beside = [], flown = null, after = null, moves = [] } = {}) {
    const nothing = { fork: null, actions: null, of: null, step: null, flown: null, episode: null, file: null };
    const { live } = this.context;
    if (live.state !== "open" && this.tracks.length) {
      toast("The server is away: your flight is kept, and another cannot begin before it is back.");
      this.emit("setup");
      return;
    }
    this.setup = { ...this.setup, ...nothing, ...change };
    this.how = { play, beside, flown: flown ?? this.setup.pilots, after, moves };
    this.emit("setup");
    this.asked = "start";
    const { task, seed, profile, fork, actions, of, step, flown: newest } = this.setup;
    const what = { task, seed, reward_profile: profile, pilots: this.how.flown };
    // The visitor's own flight goes on as a fork of nobody's, in which all moves are his.
    if (fork !== null || of !== null)
      what.fork = { actions: [...(actions ?? "")].map((one) => LETTERS[one] ?? one), step: fork ?? 0, of };
    else if (newest ?? step) what.step = newest ?? step;
    // Without a connection it is started as soon as there is one.
    this.waiting = !live.send({ type: "start", number: ++this.number, ...what });
  }

  /** Starts what every visitor can fly: where what was asked for cannot be. */
  another() {
    const task = this.task() ?? this.context.tasks[0];
    this.start({ task: task.short_name, seed: null, profile: null, pilots: this.able(task).slice(0, 1) });
  }

  /** Flies on from a step of a flight, beside it: another move, and what comes of it. */
  fork(track, step, { pilot = this.person.id, action = null } = {}) {
    const { world } = this.stage;
    // A fork of a fork stands beside what the first one had left.
    const kept = (one) => one !== track && (one.past || one.forkedAt === null);
    const left = track === this.forked ? this.stage.tracks.filter(kept) : [track];
    // Those that fly by themselves fly the same again, where the link is opened; another must be in the store.
    const again = left.filter((one) => this.pilot(one.pilot).automatic && !one.past && one.forkedAt === null);
    // They fly on beside the fork unless they have ended.
    const along = again.filter((one) => !one.done);
    const [stored = null] = left.filter((one) => !again.includes(one));
    const idsOf = (tracks) => [...tracks.map((one) => one.pilot), pilot];
    const change = {
      task: world.task.short_name,
      seed: world.seed,
      profile: world.profile,
      pilots: idsOf([...again.filter((one) => one.done), ...along]),
      episode: stored?.episode?.id ?? null,
      fork: step,
      actions: lettersOf(track.actionsTo(step)),
      of: track.by,
    };
    const after = () => action && this.fly(action);
    const play = this.pilot(pilot).automatic;
    const beside = [...new Set([...left, track])].filter((one) => !along.includes(one));
    this.start(change, { play, beside, flown: idsOf(along), after });
  }

  play(speed = this.stage.clock.speed) {
    if (this.automatic) this.context.live.send({ type: "play", speed });
  }

  pause() {
    // Nor does it go on by itself once the server is back.
    this.how.play = false;
    if (this.playing) this.context.live.send({ type: "pause" });
  }

  /** Something else is to be shown: they are paused, and those who were asked for are not waited for. */
  rest() {
    this.pause();
    this.waiting = false;
    if (this.asked === "start") this.asked = null;
  }

  step() {
    if (!this.playing && !this.over) this.context.live.send({ type: "step" });
  }

  setSpeed(speed) {
    this.stage.clock.speed = speed;
    if (this.playing) this.play(speed);
    else this.emit("playing");
  }

  /** One move of the visitor. The others move along unless they fly by themselves. */
  fly(direction) {
    if (!this.byHand) return;
    if (this.asked === "start") {
      this.how.moves.push(direction);
      return;
    }
    const flight = this.human;
    this.stage.clock.seek(this.stage.clock.newest());
    this.context.live.send({ type: "fly", flight, direction });
    if (this.automatic && !this.playing) this.context.live.send({ type: "step" });
  }

  /** Takes the visitor's last move back. */
  undo() {
    if (this.own) this.context.live.send({ type: "undo", flight: this.human });
  }

  /** The visitor wants to see values while flying, which the record says from then on. */
  help() {
    if (this.mine && !this.mine.asked) this.context.live.send({ type: "help", flight: this.human });
  }

  resume() {
    if (this.waiting) {
      this.start(this.setup, this.how);
      return;
    }
    // What has ended needs no session: it stays as it is.
    if (!this.tracks.length || this.over) return;
    this.asked = "attach";
    const sessions = this.tracks.map(({ opening }) => opening.session);
    this.context.live.send({ type: "attach", number: ++this.number, sessions });
  }

  lost() {
    if (this.playing) this.how.play = true;
    this.setPlaying(false);
  }

  begin({ flights, number, playing }) {
    // The answer to `end`: this page is about to go.
    if (!flights.length) return;
    const before = this.asked === "attach" ? this.stage.selected : null;
    const wasShown = this.shown || this.asked === "start";
    this.tracks = flights.map((flown) => new Track(flown, this.look(flown.opening.pilot), true));
    // What has been chosen since this was asked for is on its way, and stays chosen.
    const newest = number === this.number;
    const { fork, step } = this.setup;
    if (fork !== null) this.tracks.at(-1).forkedAt = fork;
    // What stands beside them does not go on.
    for (const track of this.how.beside) track.live = false;
    if (newest) {
      this.asked = null;
      const { seed, short_name } = flights[0].opening;
      const rest = this.setup.pilots.slice(0, this.setup.pilots.length - this.how.flown.length);
      const pilots = [...rest, ...this.tracks.map(({ pilot }) => pilot)];
      this.setup = { ...this.setup, seed, task: short_name, pilots };
    }
    this.setPlaying(playing);
    if (wasShown) this.show(step, before);
    this.emit("setup");
    this.emit("begun");
    if (!newest) return;
    // What a fork gives away is what it is flown for.
    if (this.setup.fork !== null) this.help();
    const { play, after, moves } = this.how;
    Object.assign(this.how, { play: false, after: null, moves: [] });
    if (play && !playing) this.play();
    after?.();
    for (const direction of moves) this.fly(direction);
  }

  /** Puts these flights on the stage: from their newest step, unless another moment is wanted. */
  show(step = null, selected = null) {
    const tracks = [...this.how.beside, ...this.tracks];
    const front = this.forked ?? this.tracks[this.human] ?? tracks[0];
    this.stage.show(worldOf(this.tracks[0].opening, this.context.tasks), tracks, {
      step: step ?? Math.max(...this.tracks.map((track) => track.steps)),
      selected: selected ?? tracks.indexOf(front),
      followed: this.tracks,
    });
  }

  move(frames) {
    clearTimeout(this.slow);
    for (const { flight, frame } of frames) {
      const track = this.tracks[flight];
      track?.frames.push(frame);
      if (track) this.stage.changed(track);
    }
  }

  undone({ flight, step, by }) {
    const track = this.tracks[flight];
    track.by = by;
    track.frames.length = step + 1;
    this.stage.changed(track);
    this.stage.clock.seek(this.stage.clock.newest());
  }

  helped({ flight, by, frame }) {
    const track = this.tracks[flight];
    track.by = by;
    track.frames[frame.step] = frame;
    this.stage.changed(track);
  }

  value({ flight, values, regrets }) {
    const track = this.tracks[flight];
    if (!track) return;
    values.forEach((value, i) => track.frames[i] && Object.assign(track.frames[i], { value, regret: regrets[i] }));
    this.stage.changed(track);
  }

  setPlaying(playing) {
    this.playing = this.stage.flying = playing;
    clearTimeout(this.slow);
    // The best flight over the largest maps takes seconds to be found, in which nobody moves.
    if (playing) this.slow = setTimeout(() => toast("A pilot is still working this map out."), PATIENCE);
    this.stage.tell("cursor");
    this.emit("playing");
  }

  ended(track, episode) {
    if (!track) return;
    track.episode = episode;
    track.live = false;
    this.stage.changed(track);
    this.emit("ended", track);
  }

  refused({ code, detail }) {
    const asked = this.asked;
    this.asked = null;
    if (asked !== "start" && code === "session_gone") {
      toast("The server has ended that flight meanwhile: it starts again.");
      this.start({ ...this.setup, ...this.told }, { ...this.how, play: this.how.play || this.playing });
      return;
    }
    // Keys come faster than what they do: one after the end of a flight, or back beyond its start, is no matter.
    if (asked === null && code === "wrong_moment") return;
    this.emit("refused", detail);
  }
}
