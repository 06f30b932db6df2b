// Fly: a map with flights over it, live or past; puts plan, boards, controls and instruments together.
import { actionsOf } from "./actions.js";
import { mountBoards } from "./boards.js";
import { mountCalls } from "./calls.js";
import { mountControls } from "./controls.js";
import { el, toast } from "./dom.js";
import { listenToDrops, mountFiles } from "./drops.js";
import { Fleet } from "./fleet.js";
import { mountHelp } from "./help.js";
import { mountHuman } from "./human.js";
import { mountInstruments } from "./instruments.js";
import { mountKeys } from "./keys.js";
import { mountLegend } from "./legend.js";
import { mountMapValues } from "./map_values.js";
import { mountMoves } from "./moves.js";
import { explain, Past } from "./past.js";
import { mountPlan } from "./plan.js";
import { says } from "./router.js";
import { mountStandings } from "./standings.js";
import { mountStrip } from "./strip.js";
import { mountSwitches } from "./switches.js";
import { mountTelemetry } from "./telemetry.js";
import { mountThinking } from "./thinking.js";

/** Milliseconds that a moment is looked at before the address says it: browsers allow few changes a second. */
const LINGER = 300;

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
  mountLegend(plan, context);
  const lesson = el("div", { hidden: true });
  middle.append(lesson);
  const problem = below("problems", mountProblem, fleet);
  const boards = below("boards-panel", mountBoards);
  below("strip", mountStrip, fleet, acts);
  const graph = below("controls-panel", mountControls, fleet, acts);
  below("human", mountHuman, fleet);
  panel("standings-panel", mountStandings, boards);
  panel("instruments", mountInstruments);
  panel("layers-panel", mountSwitches, acts);
  panel("thinking", mountThinking, fleet, acts);
  panel("calls", mountCalls);
  panel("moves-panel", mountMoves);
  panel("telemetry-panel", mountTelemetry, { boards: () => boards.boards, graph });
  mountKeys(context, fleet, acts, mountHelp());
  mountMapValues(context);
  listenToDrops((file) => openFile(() => past.openFile(file)));

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

  /** The same of a file, which has no address of its own. */
  async function openFile(flights) {
    if (context.view !== "fly") context.router.open("fly");
    if (await open(flights)) context.router.go({ view: "fly", episode: "" });
  }

  /** The moment that is shown, as the address says it: where a fork stands, what it has flown says it. */
  function step() {
    const { clock } = stage;
    if (fleet.shown && fleet.setup.fork !== null) return clock.following ? null : clock.cursor;
    return clock.cursor || null;
  }

  fleet.on("begun", () => {
    if (!fleet.shown) return;
    problem.clear();
    if (context.view === "fly") context.router.flies({ ...fleet.setup, step: step() });
  });
  stage.on("load", () => root.classList.toggle("empty", !stage.world));
  root.classList.add("empty");
  fleet.on("ended", (track) => explain(context, track));
  context.on("view", follow);

  /** Shows what the address says. */
  async function follow(view) {
    const { address } = context.router;
    // The flight that the server has put above is for those who ask for nothing.
    if (address.task || address.episode !== null) document.getElementById("hello")?.remove();
    if (address.lesson) teach(lesson, context);
    if (view !== "fly") {
      fleet.pause();
      stage.clock.stop();
    } else if (address.episode === "") {
      // a file, which stands there already
    } else if (address.episode && address.fork === null) {
      if (past.episode === address.episode) stage.clock.seek(address.step ?? stage.clock.cursor);
      else await open(() => past.open(address.episode, address.step ?? 0));
    } else await fly(address);
  }

  async function fly(address) {
    // Where the address leaves all open, the map that the server has drawn above.
    const { task, seed } = document.getElementById("hello")?.dataset ?? {};
    const asked = fleet.asks(task && !fleet.tracks.length ? { ...address, task, seed: Number(seed) } : address);
    const flown = fleet.tracks.length > 0 && says(asked, fleet.setup);
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

  // The address says which moment is shown, once somebody looks at it.
  let linger = 0;
  stage.on("cursor", () => {
    clearTimeout(linger);
    linger = setTimeout(() => {
      const { clock, track } = stage;
      const still = !clock.playing && !stage.flying && context.view === "fly" && (fleet.shown || past.episode);
      if (track && still && step() !== context.router.address.step) context.router.moment({ step: step() });
    }, LINGER);
  });
  // The flight that the server has put above has said its word once one is flown here, or another is chosen.
  let loads = 0;
  const heard = (enough) => enough && document.getElementById("hello")?.remove();
  stage.on("frames", () => heard(stage.clock.end() > 0));
  stage.on("load", () => heard(++loads > 1));
}

let teaching = null;

/** Puts the lesson above the maps; what there is to learn is loaded once somebody learns. */
function teach(root, context) {
  teaching ??= import("./lesson.js").then(
    ({ mountLesson }) => mountLesson(root, context),
    (error) => {
      teaching = null;
      toast(`The lesson could not be loaded: ${error.message}`);
    },
  );
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
