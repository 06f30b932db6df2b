// Fly: a map with live or finished flights; assembles plan, map, controls and instruments.
import { actionsOf } from "./actions.js";
import { mountBoard } from "./board.js";
import { mountCalls } from "./calls.js";
import { mountCellNote, mountTextMap } from "./cells.js";
import { mountControls } from "./controls.js";
import { mountCycle } from "./cycle.js";
import { el } from "./dom.js";
import { explain, FlightHistory, mountFiles, mountRecord } from "./history.js";
import { mountGauges, mountInstruments, mountLivePoints } from "./instruments.js";
import { mountHuman, mountKeys } from "./keys.js";
import { mountLegend } from "./legend.js";
import { mountLesson } from "./lessons.js";
import { mountMapValues, mountSwitches, mountThinking } from "./map_values.js";
import { mountMoves } from "./moves.js";
import { mountPictures } from "./picture.js";
import { mountPlan } from "./plan.js";
import { Race } from "./race.js";
import { mountResults } from "./results.js";
import { says } from "./router.js";
import { mountStandings } from "./standings.js";
import { mountByHand } from "./today.js";

/** Fills an element, as every `mountX(root, context, ...)` does. @param {HTMLElement} root @param {Context} context */
export function mountFly(root, context) {
  const { router, stage } = context;
  const race = new Race(context);
  const history = new FlightHistory(context);
  const acts = actionsOf(context, race);

  root.replaceChildren(document.getElementById("fly").content);
  const bar = root.querySelector(".plan-bar");
  const side = root.querySelector(".side");
  const alert = root.querySelector(".problem");
  /** Mounts one part of the view. */
  const part = (selector, mount, ...more) => mount(root.querySelector(selector), context, ...more);

  const choices = part(".plan", mountPlan, race, acts);
  mountFiles(choices, history, problem);
  part(".gauges", mountGauges);
  part(".lesson-bar", mountLesson);
  part(".boards-panel", mountBoard);
  part(".map", mountCellNote);
  part(".hint", mountLegend, race);
  part(".results", mountResults, race, acts);
  part(".results-next", mountCycle, race);
  part(".human", mountHuman, race);
  part(".live-points", mountLivePoints);
  part(".controls-panel", mountControls, race, acts);
  part(".by-hand-panel", mountByHand, race, acts);
  part(".standings-panel", mountStandings);
  part(".instruments", mountInstruments);
  part(".layers-panel", mountSwitches, acts);
  part(".map-in-words", mountTextMap);
  part(".buttons", mountPictures);
  part(".thinking", mountThinking, race, acts);
  part(".calls", mountCalls);
  part(".moves-panel", mountMoves);
  part(".record-panel", mountRecord);
  mountKeys(context, race, acts);
  mountMapValues(context);

  /** An error above the map, null for none; if nothing is flown, with a button that starts a flight. @param {string|null} message */
  function problem(message) {
    alert.hidden = message === null;
    if (message === null) return;
    // The open choices would cover it.
    bar.querySelector("details").open = false;
    const another = el("button.button.small", { text: "Fly another map", press: () => race.start({ seed: null }) });
    alert.replaceChildren(message, " ", ...(stage.tracks.length ? [] : [another]));
  }
  race.on("refused", problem);

  /** Loads something else than the live flights, which pause. @returns {Promise<boolean>} Whether it succeeded. */
  async function open(load) {
    race.rest();
    try {
      await load();
      lookUp();
      return true;
    } catch (error) {
      problem(error.message);
      return false;
    }
  }

  /** Shows the map and the top of the panel, unless the visitor corrects a name there. */
  function lookUp() {
    if (document.activeElement?.id === "name") return;
    side.scrollTop = 0;
    if (bar.getBoundingClientRect().top < 0) bar.scrollIntoView();
  }
  race.on("setup", () => race.starting && lookUp());

  /** What is shown, as the address contains it: a stored flight and one with moves are shown at their newest step by default. */
  function present() {
    const { cursor, following } = stage.clock;
    const flights = race.shown ? { ...race.setup, ...race.linkParts } : history.linkParts;
    const atEnd = flights.actions || !race.shown || (flights.episode && !race.forked);
    return { ...flights, step: (atEnd ? following : cursor === 0 && !flights.ended) ? null : cursor };
  }

  // The bare address greets the visitor above a map, which waits to be flown.
  const greeting = document.getElementById("hello");
  function greeted() {
    const { task, seed } = greeting.dataset;
    return race.complete({ task, seed: Number(seed), pilots: race.able(context.task(task)).slice(0, 1) });
  }
  /** Whether the map below the greeting is untouched. */
  const waits = () => says(greeted(), race.setup) && stage.clock.end() === 0;

  function writeAddress() {
    // Values of the flights that a start replaces may still arrive.
    if (!race.shown || race.starting || context.view !== "fly" || (router.bare && waits())) return;
    router.flies(present(), router.bare);
    greeting.hidden = true;
  }
  race.on("begun", writeAddress);
  stage.on("frames", () => router.bare && writeAddress());
  stage.on("load", () => problem(null));
  root.classList.add("empty");
  race.on("ended", (track) => {
    explain(context, track);
    // From now on the address names the stored flight of the visitor.
    const alone = race.tracks.length === 1 && race.human === 0 && !race.forked;
    if (alone && isShown()) router.moment({ episode: (race.setup.episode = track.episode.id) });
  });
  context.on("view", follow);

  async function follow(view) {
    const { address } = router;
    // A stored flight that is still loading for an earlier address is dropped.
    history.request += 1;
    problem(null);
    greeting.hidden = !router.bare;
    if (view !== "fly") stage.clock.stop();
    else if (address.file || (address.episode && address.fork === null)) {
      if (history.shows(address) && history.linkParts.selected === address.selected) stage.clock.seek(address.step ?? stage.clock.end());
      else await open(() => history.open(address));
    } else await fly(address);
  }

  async function fly(address) {
    const unknown = address.task && !context.task(address.task);
    if (unknown && !((await open(() => context.meet(address.task))) && router.address === address)) return;
    const wanted = router.bare ? greeted() : race.complete(address);
    const beside = address.ghost ?? address.episode;
    const { actions } = race.linkParts;
    const goesOn = () => says(wanted, race.setup) && (address.actions ?? "") === (actions ?? "");
    const flown = race.tracks.length > 0 && (router.bare ? waits() : goesOn());
    if (flown && race.shown) stage.clock.seek(address.step ?? stage.clock.cursor);
    else if (flown) race.show(address.step, address.selected - 1);
    else if (!beside) race.start(wanted);
    else {
      await open(async () => {
        const base = await history.stored(beside);
        if (address.ghost) base.colour = "--ink-3";
        // Both fly over one map, whatever the address says.
        const { task, seed } = base.opening;
        race.start({ ...wanted, task: context.task(task).short_name, seed }, { beside: [base] });
        explain(context, base);
      });
    }
  }

  /** Whether the stage shows the flight of the address. */
  function isShown() {
    const { address } = router;
    if (context.view !== "fly" || router.bare) return false;
    if (race.shown) return !race.starting && says(race.complete(address), race.setup);
    return history.shows(address);
  }

  stage.on("change", () => {
    // The panels have been drawn: none of them moves.
    root.classList.toggle("empty", !stage.track);
    if (isShown()) router.moment(present());
  });
}
