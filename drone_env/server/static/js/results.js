// Mission Results: a card over the map at the end of a flight of this page, else the first panel beside it.
import { nextFrame, TOUCH } from "./base.js";
import { announce, bring, el, fact, icon, leaveFocus, setText } from "./dom.js";
import { counted, fixed, optimumOf, outcome, percent, points, pointsBetween, signed, title } from "./format.js";
import { pointsBar } from "./points_bar.js";
import { placeOf } from "./standings.js";
import { writeProvenance } from "./track.js";

/** Milliseconds without taps after the end of a flight by hand. */
const REST = 700;
/** Windows in which the card can be beside the last cell. A smaller one has it below or beside the map. */
const ROOMY = matchMedia("(min-width: 1000px) and (min-height: 600px)");
/** The smallest width of the card over the map, and its distance from the edge and from the last cell. */
const NARROWEST = 260;
const GAP = 12;
const MOST_BUTTONS = 3;

/** @param {HTMLElement} root @param {Context} context @param {Race} race */
export function mountResults(root, context, race, acts) {
  const { stage } = context;
  const close = el("button.icon-button", { "aria-label": "Close (Esc)", title: "Close (Esc)", press: dock }, icon("M6 6l12 12M18 6L6 18"));
  const head = el("h3", { id: "results-title" });
  const score = el("strong.hero-number", { id: "final-score" });
  const optimum = el("span.hero-of", { id: "optimum" });
  const bar = el("div");
  const drawBar = pointsBar(bar);
  const place = el("p.note");
  const reason = el("p.results-reason");
  const see = el("button.link", {
    id: "worst",
    title: "Show the step before it",
    press() {
      dock();
      stage.clock.goTo(stage.track.worst.first - 1);
    },
  });
  const again = el("button.button", { id: "again", press: () => tryAgain(context, race, acts) });
  const afresh = el("button.button", { id: "start-over", text: "Start over", press: acts.reset });
  const watch = el("button.button", {
    id: "watch",
    press: () => acts.start({ pilots: [stage.track.annotation.network] }, { play: true }),
  });
  const undoes = el("p.note", { id: "undoes", text: "Trying again counts as Undo: not listed, not kept as your best." });
  const next = el("button.button", { id: "next", press: () => goOn(context, race, acts) });
  const efficiency = el("div", { id: "efficiency-parts" });
  const analysis = el("div", { id: "analysis" });
  const first = el(
    "div.results-first",
    el("div.panel-head", el("h2", { id: "results-name", text: "Mission Results" }), close),
    head,
    el("p.hero", score, " ", optimum),
    bar,
    place,
    reason,
    see,
    el("div.results-actions", next, again, watch, afresh),
    undoes,
  );
  // What starts the next flight by itself goes to the foot.
  root.append(first, efficiency, analysis, el("div.results-next", { id: "results-next" }));
  root.setAttribute("aria-labelledby", "results-name results-title");
  const view = document.getElementById("view-fly");
  const isOver = () => root.classList.contains("over");
  let announced = null;
  let analysed = null;
  /** The flight whose card the visitor has closed. */
  let closed = null;
  race.on("ended", (track) => track === stage.track && nextFrame(() => isOver() || bring(first)));

  /** Puts the card beside the map for good. */
  function dock() {
    closed = stage.track;
    root.classList.remove("over");
  }
  document.addEventListener("keydown", ({ key }) => {
    if (key === "Escape" && isOver() && !document.querySelector("dialog[open], .plan-details[open]")) dock();
  });

  /** Places the card over the map on the side of the last cell that has more room; without room it is beside the map. */
  function put({ layout, size, track }) {
    const own = !track.brought && stage.over && closed !== track && ROOMY.matches;
    const map = document.getElementById("boards").getBoundingClientRect();
    const { cell } = layout;
    const left = (layout.left + track.last.x * cell) / size.scale;
    const right = map.width - left - cell / size.scale;
    const width = Math.min(380, Math.max(left, right) - 2 * GAP);
    const over = own && width >= NARROWEST;
    root.classList.toggle("over", over);
    if (!over) return;
    const x = left > right ? map.left + GAP : map.right - GAP - width;
    for (const [name, value] of Object.entries({ x, y: map.top + GAP, width, height: map.height - 2 * GAP }))
      root.style.setProperty(`--card-${name}`, `${Math.round(value)}px`);
  }
  context.on("drawn", (drawn) => root.hidden || put(drawn));

  function draw() {
    const { track, world, clock } = stage;
    const hidden = !track || !(track.done || track.past);
    if (root.hidden !== hidden) root.hidden = hidden;
    if (hidden) return;
    const { last, annotation, worst } = track;
    root.dataset.outcome = last.outcome;
    // A card over the map would hide the moments before the end.
    root.classList.toggle("away", !clock.following);
    setText(head, `${track.name}: ${outcome(last)}.`);
    setText(score, points(last.score));
    const best = optimumOf(track);
    setText(optimum, best === null ? "" : `/ ${points(best)} possible`);
    drawBar(partsOf(last, best));
    setText(place, placeOf(stage));
    const why = whyOf(track);
    if (annotation?.why && reason.textContent !== why) announce(why);
    setText(reason, why);
    see.hidden = !worst;
    if (worst) setText(see, worstOf(track, worst));
    const own = !track.automatic && track.forkedAt === null;
    undoes.hidden = !own || !annotation?.rescue_step;
    const step = stepToTry(track);
    setText(again, `${annotation?.why ? (track.automatic ? "Try it yourself" : "Try again") : "Try"} from ${step ? `step ${step}` : "the start"}`);
    if (annotation?.network) setText(watch, `Watch ${context.pilot(annotation.network).name}`);
    const after = nextTask(context.families, world.task);
    setText(next, `Next: ${title(after.short_name)}`);
    const goesOn = after === world.task ? [] : [next];
    const delivered = last.outcome === "delivered";
    const shown = [
      ...(delivered ? goesOn : []),
      ...(worst || (annotation?.unsolved && !delivered) ? [again] : []),
      ...(own && annotation?.network ? [watch] : []),
      ...(own && (!annotation?.why || !undoes.hidden) ? [afresh] : []),
      ...(delivered || !track.done ? [] : goesOn),
    ].slice(0, MOST_BUTTONS);
    for (const button of [next, again, watch, afresh]) {
      button.hidden = !shown.includes(button);
      button.classList.toggle("primary", button === shown[0]);
    }
    drawEfficiency(efficiency, last);
    if (analysed !== track && (track.past || track.episode)) {
      analysed = track;
      analyse(world.task);
    }
    if (announced === track) return;
    // The card takes the place of the pad: a tap that is on its way presses nothing.
    if (TOUCH && own && !track.brought) {
      view.inert = true;
      setTimeout(() => (view.inert = false), REST);
    }
    announced = track;
    if (track.done && (track.live || track.episode)) announce(`Mission Results: ${outcome(last)}. Score ${points(last.score)}.`);
  }

  async function analyse(task) {
    try {
      const figures = await context.api.get(`analyse/${encodeURIComponent(task.id)}`);
      if (stage.world.task === task) analysis.replaceChildren(...statistics(figures, task));
    } catch (error) {
      analysis.replaceChildren(el("p.note", { text: `The statistics of this task could not be loaded: ${error.message}` }));
    }
  }

  stage.on("change", draw);
}

/** The parts of the final score, and what is lost of the optimum. */
function partsOf({ score, deliveries_done: delivered, efficiency_parts }, optimum) {
  const [parcels, battery, steps] = efficiency_parts;
  const points = pointsBetween(0, parcels.score, parcels.score + battery.score, score, optimum ?? score);
  /** @type {import("./points_bar.js").Part[]} */
  const parts = [
    ["parcels", points[0], delivered ? parcels.name : "lowest score"],
    ["battery", points[1], battery.name],
    ["steps", points[2], steps.name],
    ["lost", points[3], "lost"],
  ];
  return parts.filter(([, value]) => value > 0.01);
}

/** Why the flight failed, or how it compares, in a sentence. */
function whyOf({ done, annotation, unexplained }) {
  if (!done) return "This flight is not finished, so its moves have no marks.";
  if (unexplained) return `This flight is not compared with a best one: ${unexplained}`;
  if (!annotation) return "Comparing this flight with a best one …";
  if (annotation.why) return annotation.why;
  if (annotation.unsolved) return `The best flight is not known: ${annotation.unsolved}.`;
  return annotation.worst ? "" : "No flight over this map scores more.";
}

/** The worst move, or the loop as a whole: `Steps 17 to 79, lost 4.2: circled a pad for 63 steps`. */
function worstOf({ annotation, frames }, { first, last, regret, why }) {
  const span = first === last ? `Step ${first}, ${frames[first].action}` : `Steps ${first} to ${last}`;
  // The reason names the loop already.
  if (annotation.why.includes(why)) return `See step ${first}`;
  return `${span}${regret === null ? "" : `, lost ${points(regret)}`}: ${why}`;
}

/** The step before the last one that could be saved; of a flight that delivered all parcels, before its worst move. */
const stepToTry = ({ annotation, worst }) => (annotation?.why ? annotation.rescue_step : worst && worst.first - 1) ?? 0;

function drawEfficiency(root, { efficiency, efficiency_parts: parts }) {
  const meters = parts.map(({ name, weight, share }) =>
    el(
      "div.part",
      el("span", { text: title(name) }),
      el("span.gauge-bar", { "aria-hidden": "true" }, el("i", { style: { "--share": String(share) } })),
      el("span", { text: `${fixed(weight * share, 1)} of ${weight}` }),
    ),
  );
  root.replaceChildren(el("h3", { text: `Efficiency ${fixed(efficiency, 1)} of 100 (not the score)` }), ...meters);
}

/** The answer of `GET /analyse`: means, the trend, and a bar for each action. */
function statistics(figures, task) {
  const actions = Object.entries(figures.action_distribution).map(([action, share]) =>
    el("div.action-share", { style: { "--share": String(share) } }, el("i", { "aria-hidden": "true" }), `${action} ${percent(share)}`),
  );
  return [
    el("h3", { text: `${counted(figures.episodes, "flight")} of ${title(task.short_name)} on this server` }),
    el(
      "dl.results-facts",
      fact("Average reward", fixed(figures.average_reward)),
      fact("Average score", points(figures.average_score)),
      fact("Success", percent(figures.success_rate)),
      fact("Success trend", figures.success_trend === null ? "–" : `${signed(figures.success_trend * 100, 0)} points`),
    ),
    el("div.action-shares", { role: "group", "aria-label": "Action distribution" }, ...actions),
  ];
}

/** The next task of the family, or the last one again. Only the standard ones begin again: Easy, Medium, Hard, Easy. */
function nextTask(families, task) {
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
