// Mission Results: a card over the map at the end of a flight of this page, else the first panel beside it.
import { nextFrame, TOUCH } from "./base.js";
import { announce, el, fact, leaveFocus, onPress, setText } from "./dom.js";
import { counted, fixed, optimumOf, outcome, percent, points, pointsBetween, signed, title } from "./format.js";
import { drawPoints } from "./instruments.js";
import { placeOf } from "./standings.js";
import { writeProvenance } from "./track.js";

/** Milliseconds without taps after the end of a flight by hand. */
const REST = 700;
/** Windows in which the card can be beside the last cell. A smaller one has it below or beside the map. */
const ROOMY = matchMedia("(min-width: 1000px) and (min-height: 600px)");
/** Widths of the card over the map, and its distance from the edge and from the last cell. */
const [NARROWEST, WIDEST, GAP] = [260, 380, 12];
const MOST_BUTTONS = 3;

/** @param {HTMLElement} root @param {Context} context @param {Race} race */
export function mountResults(root, context, race, acts) {
  const { stage } = context;
  const [heading, hero, best, parts, place, reason, worst, ways, undoes, efficiency, analysis] = root.querySelectorAll(
    "h3, .hero-number, .hero-of, .score-parts, #place, .results-reason, #worst, .results-actions, #undoes, #efficiency-parts, #analysis",
  );
  const [again, watch, over, next] = ways.querySelectorAll("button");
  const view = document.getElementById("view-fly");
  /** The flight that the card has announced, and the one whose card the visitor has closed. */
  let [met, closed, request] = [null, null, 0];
  const isOver = () => root.classList.contains("over");
  onPress(root, {
    "close-results": dock,
    worst: () => stage.clock.goTo(stage.track.worst.first - 1),
    again: () => tryAgain(context, race, acts),
    watch: () => acts.start({ pilots: race.able(stage.world.task).slice(0, 1) }, { play: true }),
    "start-over": acts.reset,
    next: () => goOn(context, race, acts),
  });

  /** Puts the card beside the map for good. */
  function dock() {
    closed = stage.track;
    root.classList.remove("over");
  }
  document.addEventListener("keydown", ({ key }) => {
    if (key === "Escape" && isOver() && !document.querySelector("dialog[open], .plan-details[open]")) dock();
  });

  /**
   * Places the card over the map on the side of the last cell that has more room. Without room, and while the visitor
   * looks back, it is beside the map.
   */
  context.on("drawn", ({ layout, size, track, clock }) => {
    if (root.hidden) return;
    const map = document.getElementById("boards").getBoundingClientRect();
    const left = (layout.left + track.last.x * layout.cell) / size.scale;
    const right = map.width - left - layout.cell / size.scale;
    const width = Math.min(WIDEST, Math.max(left, right) - 2 * GAP);
    const ends = !track.brought && stage.over && clock.following && closed !== track;
    root.classList.toggle("over", ends && ROOMY.matches && width >= NARROWEST);
    const x = left > right ? map.left + GAP : map.right - GAP - width;
    const card = { x, y: map.top + GAP, width, height: map.height - 2 * GAP };
    for (const [name, value] of Object.entries(card)) root.style.setProperty(`--card-${name}`, `${Math.round(value)}px`);
  });

  stage.on("change", () => {
    const { track } = stage;
    root.hidden = !track || !(track.done || track.past);
    if (root.hidden) return;
    const { annotation, name, last } = track;
    const optimum = optimumOf(track);
    root.dataset.outcome = last.outcome;
    setText(heading, `${name}: ${outcome(last)}.`);
    setText(hero, points(last.score));
    setText(best, optimum === null ? "" : ` / ${points(optimum)} possible`);
    drawPoints(parts, partsOf(last, optimum));
    setText(place, placeOf(stage));
    if (annotation?.why && reason.textContent !== whyOf(track)) announce(annotation.why);
    setText(reason, whyOf(track));
    worst.hidden = !track.worst;
    if (track.worst) setText(worst, worstOf(annotation, track.frames[track.worst.first].action));
    drawWays(track);
    if (met !== track) meet(track);
  });

  /** At most three ways on, the first of which stands out. */
  function drawWays(track) {
    const { annotation, automatic, last, done, forkedAt } = track;
    const delivered = last.outcome === "delivered";
    const own = !automatic && forkedAt === null;
    const after = nextTask(context.families, stage.world.task);
    const step = stepToTry(track);
    const verb = annotation?.why ? (automatic ? "Try it yourself" : "Try again") : "Try";
    setText(again, `${verb} from ${step ? `step ${step}` : "the start"}`);
    setText(next, `Next: ${title(after.short_name)}`);
    const [pilot] = race.able(stage.world.task);
    if (pilot) setText(watch, `Watch ${context.pilot(pilot).name}`);
    // Another move in the document would take its focus away.
    if (delivered !== (ways.firstElementChild === next)) ways.insertBefore(next, delivered ? again : null);
    const offered = new Map([
      [again, track.worst || (annotation?.unsolved && !delivered)],
      [watch, own && pilot],
      [over, own && (!annotation?.why || annotation.rescue_step)],
      [next, done && after !== stage.world.task],
    ]);
    const shown = [...ways.querySelectorAll("button")].filter((way) => offered.get(way)).slice(0, MOST_BUTTONS);
    for (const way of offered.keys()) {
      way.hidden = !shown.includes(way);
      way.classList.toggle("primary", way === shown[0]);
    }
    undoes.hidden = !(own && annotation?.rescue_step);
  }

  /** Announces the end of a flight, and asks for the statistics. */
  function meet(track) {
    const { last, live, episode, done, brought, automatic, forkedAt } = track;
    met = track;
    efficiency.replaceChildren(...efficiencyOf(last));
    if (analysis.dataset.task !== stage.world.task.id) analysis.replaceChildren();
    // The card takes the place of the pad: a tap that is on its way presses nothing.
    if (TOUCH && !automatic && forkedAt === null && !brought) {
      view.inert = true;
      setTimeout(() => (view.inert = false), REST);
    }
    if (done && (live || episode)) announce(`Mission Results: ${outcome(last)}. Score ${points(last.score)}.`);
    if (!live) analyse();
  }

  async function analyse() {
    const { task } = stage.world;
    const mine = ++request;
    const failed = ({ message }) => ({ failed: message });
    const answer = await context.api.get(`analyse/${encodeURIComponent(task.id)}`).catch(failed);
    if (mine !== request || stage.world.task !== task) return;
    analysis.dataset.task = task.id;
    analysis.replaceChildren(...statistics(answer, title(task.short_name)));
  }
  race.on("ended", analyse);
  race.on("ended", (track) => track === stage.track && nextFrame(() => isOver() || root.firstElementChild.scrollIntoView({ block: "nearest" })));
}

/** The parts of the final score, and what is lost of the optimum. @returns {[string, number, string][]} */
function partsOf({ score, deliveries_done: delivered, efficiency_parts }, optimum) {
  const [parcels, battery, steps] = efficiency_parts;
  const names = [delivered ? parcels.name : "lowest score", battery.name, steps.name, "lost"];
  const values = pointsBetween(0, parcels.score, parcels.score + battery.score, score, optimum ?? score);
  return ["parcels", "battery", "steps", "lost"].map((kind, i) => [kind, values[i], names[i]]);
}

/** Why the flight failed, or how it compares, in a sentence. */
function whyOf({ done, annotation, unexplained }) {
  if (!done) return "This flight is not finished, so its moves have no marks.";
  if (unexplained) return `This flight is not compared with a best one: ${unexplained}`;
  if (!annotation) return "Comparing this flight with a best one …";
  if (annotation.unsolved) return `${annotation.why} The best flight is not known: ${annotation.unsolved}.`;
  return annotation.why || (annotation.worst ? "" : "No flight over this map scores more.");
}

/** The worst move, or the loop as a whole: `Steps 17 to 79, lost 4.2: circled a pad for 63 steps`. */
function worstOf({ why: reason, worst: { first, last, regret, why } }, action) {
  // The reason names the loop already.
  if (reason.includes(why)) return `See step ${first}`;
  const span = first === last ? `Step ${first}, ${action}` : `Steps ${first} to ${last}`;
  return `${span}${regret === null ? "" : `, lost ${points(regret)}`}: ${why}`;
}

/** The step before the last one that could be saved; of a flight that delivered all parcels, before its worst move. */
const stepToTry = ({ annotation, worst }) => (annotation?.why ? annotation.rescue_step : worst && worst.first - 1) ?? 0;

function efficiencyOf({ efficiency, efficiency_parts: parts }) {
  const meter = (share) => el("span.gauge-bar", { "aria-hidden": "true" }, el("i", { style: { "--share": String(share) } }));
  return [
    el("h3", { text: `Efficiency ${fixed(efficiency, 1)} of 100 (not the score)` }),
    ...parts.map(({ name, weight, share }) =>
      el("div.part", el("span", { text: title(name) }), meter(share), el("span", { text: `${fixed(weight * share, 1)} of ${weight}` })),
    ),
  ];
}

/** The answer of `GET /analyse`: means, the trend, and a bar for each action. */
function statistics({ episodes, success_trend: trend, action_distribution: shares, failed, ...means }, task) {
  if (failed) return [el("p.note", { text: `The statistics of this task could not be loaded: ${failed}` })];
  const bar = ([action, share]) =>
    el("div.action-share", { style: { "--share": String(share) } }, el("i", { "aria-hidden": "true" }), `${action}\n${percent(share)}`);
  return [
    el("h3", { text: `${counted(episodes, "flight")} of ${task} on this server` }),
    el(
      "dl.results-facts",
      fact("Average reward", fixed(means.average_reward)),
      fact("Average score", points(means.average_score)),
      fact("Success", percent(means.success_rate)),
      fact("Success trend", trend === null ? "–" : `${signed(trend * 100, 0)} points`),
    ),
    el("div.action-shares", { role: "group", "aria-label": "Action distribution" }, ...Object.entries(shares).map(bar)),
  ];
}

/** The next task of the family, or the last one again. Only the standard ones begin again: Easy, Medium, Hard, Easy. */
export function nextTask(families, task) {
  const group = families.get(task.family);
  return group[group.indexOf(task) + 1] ?? (task.family === "standard" ? group[0] : task);
}

/** Continues a failed flight from the last step at which all parcels could still be delivered, another from its worst move. @param {Context} context @param {Race} race */
function tryAgain({ stage }, race, acts) {
  const { track } = stage;
  const step = stepToTry(track);
  leaveFocus();
  if (track.automatic || track.forkedAt !== null || !track.annotation.why) {
    stage.clock.goTo(step);
    acts.fork();
  } else if (step === 0) acts.reset();
  else {
    // The record notes that moves were taken back.
    const of = writeProvenance({ ...track.provenance, person: null, undo_used: true });
    acts.start({ of, actions: track.lettersTo(step) });
  }
}

function goOn(context, race, acts) {
  const next = nextTask(context.families, context.stage.world.task);
  const flown = race.shown ? race.setup.pilots : [context.stage.track.pilot];
  const pilots = [...new Set(flown)].filter((id) => race.flies(id, next));
  acts.start({ task: next.short_name, seed: null, pilots });
  // The focus moves to Start; if the visitor flies, the keys are for the drone.
  if (race.byHand) leaveFocus();
  else document.getElementById("start").focus({ preventScroll: true });
}
