// The live flights of this page: what is asked of the server, and what it tells.
import { toast } from "./dom.js";
import { Emitter } from "./emitter.js";

export const SPEEDS = [0.5, 1, 2, 4, 6, 10, 15, 30, 60];
const DEFAULT_SPEED = 6;
const HUMAN_SPEED = 8;
const PATIENCE = 2500;

/**
 * @typedef {Object} Setup What is flown.
 * @property {string} task Short name. @property {number|null} seed null for any map. @property {string|null} profile null for the
 *   server's.
 * @property {string[]} pilots One to four ids.
 *
 * Events: "setup" other flights were chosen, "playing" started, paused or another speed, "refused" (text).
 */
export class Fleet extends Emitter {
  /** @param {import("./context.js").Context} context */
  constructor(context) {
    super();
    this.context = context;
    /** @type {Setup} */
    this.setup = { task: context.tasks[0].short_name, seed: null, profile: null, pilots: [] };
    this.playing = false;
    this.speed = DEFAULT_SPEED;
    this.asked = null;
    this.number = 0;
    this.playAfterStart = false;
    this.wanted = false;
    this.waiting = false;
    this.slow = 0;
    const { live } = context;
    live.on("state", ({ state }) => (state === "open" ? this.resume() : this.lost()));
    live.on("flights", (message) => this.begin(message));
    live.on("frames", ({ frames }) => this.move(frames));
    live.on("values", ({ flight, values, regrets }) => context.players[flight].setValues(values, regrets));
    live.on("playing", ({ playing, speed }) => this.setPlaying(playing, speed));
    live.on("ended", ({ flight, episode }) => this.ended(flight, episode));
    live.on("error", (message) => this.refused(message));
    // A page that is closed gives its sessions back: nobody could attach to them, and they take the room of others.
    window.addEventListener("pagehide", ({ persisted }) => persisted || live.send({ type: "end" }));
  }

  /** The players that have a flight. */
  get active() {
    return this.context.players.filter((player) => !player.empty);
  }

  /** Whether all flights have ended. */
  get over() {
    return this.active.length > 0 && this.active.every((player) => player.last.done);
  }

  /** The index of the flight that the visitor flies; -1 for none. */
  get human() {
    const { players } = this.context;
    return this.setup.pilots.findIndex((id, i) => i < players.length && !this.pilot(id).automatic);
  }

  /** Whether there is somebody to start. */
  get automatic() {
    return this.setup.pilots.some((id) => this.pilot(id).automatic);
  }

  /** @returns {Object} What the server tells of a pilot; a stand-in where it does not know it. */
  pilot(id) {
    return (
      this.context.pilots.find((pilot) => pilot.id === id) ?? { id, name: id, summary: "", automatic: true, tasks: [] }
    );
  }

  task(name = this.setup.task) {
    return this.context.tasks.find((task) => task.short_name === name || task.id === name || task.grader === name);
  }

  /** Whether a pilot can fly a task. */
  flies(id, task = this.task()) {
    return !task || this.pilot(id).tasks.includes(task.id);
  }

  /** Ids of all who fly a task by themselves, as the server lists them. */
  able(task = this.task()) {
    return this.context.pilots.filter(({ id, automatic }) => automatic && this.flies(id, task)).map(({ id }) => id);
  }

  /** What an address asks for, filled up with what is flown now. @param {import("./router.js").Address} address */
  asks({ task = null, seed = null, profile = null, pilots }, most) {
    const known = this.task(task ?? this.setup.task) ?? this.context.tasks[0];
    const named = pilots.length ? pilots : this.setup.pilots.filter((id) => this.flies(id, known));
    // Where too few are named others join in, the visitor's own network first, if one was trained for the task.
    const enough = named.length >= Math.min(most, 2);
    const flown = enough ? named : [...new Set([...named, ...this.able(known)])].slice(0, most);
    return {
      task: task === null || this.task(task) ? known.short_name : task, // the server says what is wrong with another
      seed,
      profile,
      pilots: most > 1 ? flown : flown.slice(0, 1),
    };
  }

  /** Starts other flights: what is named in `change` is new, the rest as it was. */
  start(change = {}, { play = false } = {}) {
    this.setup = { ...this.setup, ...change };
    this.playAfterStart = play;
    this.emit("setup");
    this.asked = "start";
    const { task, seed, profile, pilots } = this.setup;
    // Without a connection it is started as soon as there is one.
    const what = { task, seed, reward_profile: profile, pilots };
    this.waiting = !this.context.live.send({ type: "start", number: ++this.number, ...what });
  }

  /** Called when flights are to be seen for the first time: until then none is flown. */
  want(setup) {
    this.wanted = true;
    this.setup = setup;
    this.emit("setup");
    if (this.context.live.state === "open") this.start();
  }

  play(speed = this.speed) {
    this.speed = speed;
    if (!this.over && this.automatic) this.context.live.send({ type: "play", speed });
  }

  pause() {
    this.context.live.send({ type: "pause" });
  }

  /** Starts or pauses; after the end, flies the same map again. */
  toggle() {
    if (this.over) this.start({}, { play: true });
    else if (this.playing) this.pause();
    else this.play();
  }

  step() {
    if (!this.playing && !this.over) this.context.live.send({ type: "step" });
  }

  /** Another speed, at once where something flies. */
  setSpeed(speed) {
    this.speed = speed;
    if (this.playing) this.play(speed);
    else this.emit("playing");
  }

  /** One move of the visitor. The others move along unless they fly by themselves. */
  fly(direction) {
    const mission = this.human;
    const player = this.context.players[mission];
    if (mission < 0 || !player.last || player.last.done) return;
    player.seek(player.frames.length - 1);
    this.context.live.send({ type: "fly", flight: mission, direction });
    if (this.automatic && !this.playing) this.context.live.send({ type: "step" });
  }

  resume() {
    const sessions = this.active.map((player) => player.mission.session);
    if (!this.wanted) return;
    if (this.waiting || !sessions.length) {
      this.start({}, { play: this.playAfterStart });
      return;
    }
    // What has ended needs no session: it stays as it is.
    if (this.over) return;
    this.asked = "attach";
    this.context.live.send({ type: "attach", number: ++this.number, sessions });
  }

  lost() {
    if (this.playing) this.playAfterStart = true;
    this.setPlaying(false, this.speed);
  }

  begin({ flights, number, playing, speed }) {
    // The answer to `end`: this page is about to go.
    if (!flights.length) return;
    const { players } = this.context;
    players.forEach((player, i) => {
      const flight = flights[i];
      if (!flight) player.clear();
      else player.load(flight.opening, flight.frames, { atEnd: true });
      player.episode = null;
    });
    // What has been chosen since this was asked for is on its way, and stays chosen.
    const newest = number === this.number;
    if (newest) {
      this.asked = null;
      const { seed, short_name } = flights[0].opening;
      this.setup = { ...this.setup, seed, task: short_name, pilots: flights.map(({ opening }) => opening.pilot) };
    }
    this.speed = playing ? speed : this.speed;
    this.setPlaying(playing, this.speed);
    this.emit("setup");
    this.context.emit("missions", this.active);
    if (newest && this.playAfterStart && !playing) this.play();
    if (newest) this.playAfterStart = false;
  }

  move(frames) {
    clearTimeout(this.slow);
    for (const { flight, frame } of frames) this.context.players[flight]?.push(frame);
  }

  setPlaying(playing, speed) {
    this.playing = playing;
    clearTimeout(this.slow);
    // The best flight over the largest maps takes seconds to be found, in which nobody moves.
    if (playing) this.slow = setTimeout(() => toast("A pilot is still working this map out."), PATIENCE);
    if (playing) this.speed = speed;
    for (const player of this.context.players) {
      player.flying = playing && Boolean(player.last) && !player.last.done;
      player.speed = this.setup.pilots.length === 1 && !this.automatic ? HUMAN_SPEED : this.speed;
      player.tell("change");
    }
    this.emit("playing");
  }

  ended(mission, episode) {
    const player = this.context.players[mission];
    if (!player) return;
    player.episode = episode;
    player.flying = false;
    player.tell("frames");
    this.context.emit("ended", mission, episode);
  }

  refused({ code, detail }) {
    const asked = this.asked;
    this.asked = null;
    if (asked !== "start" && code === "session_gone") {
      toast("The server has ended that flight meanwhile: it starts again.");
      this.start({}, { play: this.playAfterStart || this.playing });
      return;
    }
    this.emit("refused", detail);
  }
}
