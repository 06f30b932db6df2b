// Fly: a map with flights over it, live or past; puts plan, boards, controls and instruments together.
import { actionsOf } from "./actions.js";
import { mountBoards } from "./boards.js";
import { mountCalls } from "./calls.js";
import { mountControls } from "./controls.js";
import { el } from "./dom.js";
import { Fleet } from "./fleet.js";
import { help } from "./help.js";
import { mountInstruments } from "./instruments.js";
import { mountHuman, mountKeys } from "./keys.js";
import { mountLegend } from "./legend.js";
import { mountMapValues, mountSwitches } from "./map_values.js";
import { mountMoves } from "./moves.js";
import { explain, mountFiles, Past } from "./past.js";
import { mountPlan } from "./plan.js";
import { says } from "./router.js";
import { mountStandings } from "./standings.js";
import { mountStrip } from "./strip.js";
import { mountTelemetry } from "./telemetry.js";
import { mountThinking } from "./thinking.js";

/** @param {HTMLElement} root @param {import("./context.js").Context} context */
export function mountFly(root, context) {
  const { stage } = context;
  const fleet = new Fleet(context);
  const past = new Past(context, fleet);
  const acts = actionsOf(context, fleet);
  /** Whether values are kept back: a person flies who has not asked for them. */
  context.secret = (track) => track.live && !track.done && !track.asked && !fleet.pilot(track.pilot).automatic;

  const plan = el("aside.plan", { "aria-label": "What is flown" });
  const middle = el("div.middle");
  const side = el("aside.side", { "aria-label": "The flight" });
  const below = (name, mount, ...more) => mounted(middle, `div.${name}`, mount, ...more);
  const panel = (name, mount, ...more) => mounted(side, `section.panel.${name}`, mount, ...more);
  function mounted(parent, tag, mount, ...more) {
    const node = el(tag);
    parent.append(node);
    return mount(node, context, ...more);
  }
  root.append(plan, middle, side);

  mountPlan(plan, context, fleet, acts);
  mountFiles(plan, past, openFile);
  const lesson = el("div.lesson-bar", { hidden: true });
  let teaching = null;
  middle.append(lesson);
  const problem = below("problems", mountProblem, fleet);
  below("boards-panel", mountBoards);
  mountLegend(plan, context);
  below("strip", mountStrip, fleet, acts);
  below("controls-panel", mountControls, fleet, acts);
  below("human", mountHuman, fleet);
  panel("standings-panel", mountStandings);
  panel("instruments", mountInstruments);
  panel("layers-panel", mountSwitches, acts);
  panel("thinking", mountThinking, fleet, acts);
  panel("calls", mountCalls);
  panel("moves-panel", mountMoves);
  panel("telemetry-panel", mountTelemetry);
  mountKeys(context, fleet, acts, help);
  document.getElementById("help-button").addEventListener("click", help);
  mountMapValues(context);

  /** Shows flights of the past: the live ones rest. @returns {Promise<boolean>} Whether they are there. */
  async function open(flights) {
    fleet.rest();
    problem.clear();
    try {
      await flights();
      return true;
    } catch (error) {
      problem.say(error.message);
      return false;
    }
  }

  /** The same of a file. */
  async function openFile(flights) {
    if (await open(flights)) context.router.go({ file: past.file });
  }

  /** The moment that is shown, as the address says it: where one flies is the last of the moves that it has. */
  function told() {
    const { cursor, following } = stage.clock;
    const moves = fleet.told;
    const unsaid = moves.actions ? following : cursor === 0;
    const flown = !fleet.shown || moves.actions || following ? null : stage.clock.newest();
    return { ...moves, step: unsaid ? null : cursor, flown };
  }

  // Who asks for nothing is greeted with a flight that the server has drawn above, whose map waits below to be flown.
  const greeting = document.getElementById("hello");
  const greets = () => greeting !== null && context.router.bare;
  function greeted() {
    const { task, seed } = greeting.dataset;
    return fleet.asks({ task, seed: Number(seed), pilots: fleet.able(fleet.task(task)).slice(0, 1) });
  }
  /** Whether nobody has touched what waits there. */
  const waits = () => says(greeted(), fleet.setup) && stage.clock.end() === 0;

  function sayWhatIsFlown() {
    if (!fleet.shown || context.view !== "fly" || (greets() && waits())) return;
    context.router.flies({ ...fleet.setup, ...told() }, greets());
    if (greeting) greeting.hidden = true;
  }
  fleet.on("begun", () => {
    if (fleet.shown) problem.clear();
    sayWhatIsFlown();
  });
  stage.on("frames", () => greets() && sayWhatIsFlown());
  stage.on("load", () => root.classList.remove("empty"));
  root.classList.add("empty");
  fleet.on("ended", (track) => {
    explain(context, track);
    // The visitor's flight is found in the store from now on.
    const alone = fleet.tracks.length === 1 && fleet.human === 0 && !fleet.forked;
    if (alone && isThere()) context.router.moment({ episode: (fleet.setup.episode = track.episode.id) });
  });
  context.on("view", follow);

  /** Shows what the address says. */
  async function follow(view) {
    const { address } = context.router;
    // A flight that an earlier address asked for is not shown any more.
    past.asked += 1;
    if (address.lesson)
      teaching ??= import("./lessons.js").then(
        ({ mountLesson }) => mountLesson(lesson, context),
        ({ message }) => {
          teaching = null;
          problem.say(`The lesson could not be loaded: ${message}`);
        },
      );
    if (greeting) greeting.hidden = !greets();
    if (view !== "fly") {
      fleet.pause();
      stage.clock.stop();
    } else if (address.file) {
      if (past.file === address.file) stage.clock.seek(address.step ?? stage.clock.cursor);
      else await open(() => past.openRecord(0, address.file));
    } else if (address.episode && address.fork === null) {
      if (past.episode === address.episode) stage.clock.seek(address.step ?? stage.clock.cursor);
      else await open(() => past.open(address.episode, address.step ?? 0));
    } else await fly(address);
  }

  async function fly(address) {
    const unknown = address.task && !fleet.task(address.task);
    if (unknown && !((await open(() => context.meet(address.task))) && context.router.address === address)) return;
    const asked = greets() ? greeted() : fleet.asks(address);
    const flown = fleet.tracks.length > 0 && (greets() ? waits() : says(asked, fleet.setup));
    if (flown && fleet.shown) stage.clock.seek(address.step ?? stage.clock.cursor);
    else if (flown) fleet.show(address.step);
    else if (!address.episode) fleet.start(asked);
    else {
      await open(async () => {
        const base = await past.stored(address.episode);
        fleet.start(asked, { beside: [base], flown: asked.pilots.slice(-1) });
        explain(context, base);
      });
    }
  }

  /** Whether what the address names is on the stage, and not still on its way. */
  function isThere() {
    const { address } = context.router;
    if (context.view !== "fly") return false;
    if (fleet.shown) return fleet.asked === null && says(fleet.asks(address), fleet.setup);
    if (address.file) return past.file === address.file;
    return Boolean(address.episode) && address.fork === null && stage.track?.episode?.id === address.episode;
  }

  // The address says what the visitor has flown, and which moment is shown, unless it moves by itself.
  stage.on("change", () => {
    if (stage.clock.playing || !isThere()) return;
    const now = told();
    if (now.actions || !stage.flying) context.router.moment(now);
  });
}

/** What went wrong, above the maps; where nothing is flown, with a way on. */
function mountProblem(root, context, fleet) {
  const text = el("p.problem", { role: "alert", hidden: true });
  root.append(text);
  const another = el("button.button.small", {
    text: "Fly another map",
    press: () => fleet.another(),
  });
  const problem = {
    say(words) {
      text.replaceChildren(words, " ", ...(context.stage.tracks.length ? [] : [another]));
      text.hidden = false;
    },
    clear() {
      text.hidden = true;
    },
  };
  fleet.on("refused", problem.say);
  return problem;
}
