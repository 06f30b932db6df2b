// Mission Results: a card over the map at the end of a flight of this page, else the first panel beside it.
import { nextFrame, TOUCH } from "./base.js";
import { announce, bring, el, fact, icon, keepFocus, leaveFocus } from "./dom.js";
import { counted, fixed, optimumOf, outcome, percent, points, pointsBetween, signed, title } from "./format.js";
import { pointsBar } from "./points_bar.js";
import { placeOf } from "./standings.js";
import { writeProvenance } from "./track.js";

/** Milliseconds without taps after the end of a flight by hand. */
const REST = 700;
/** Windows in which the card can be beside the last cell. A smaller one has it below or beside the map. */
const ROOMY = matchMedia("(min-width: 1000px) and (min-height: 600px)");
/** Widths of the card over the map, and its distance from the edge and from the last cell. */
const [NARROWEST, WIDEST, GAP] = [260, 380, 12];
const MOST_BUTTONS = 3;
const CROSS = "M6 6l12 12M18 6L6 18";
const UNDOES = "Trying again counts as Undo: not listed, not kept as your best.";

/** @param {HTMLElement} root @param {Context} context @param {Race} race */
export function mountResults(root, context, race, acts) {
  const { stage } = context;
  const first = el("div.results-first");
  const rest = el("div.results-rest");
  root.append(first, rest);
  root.setAttribute("aria-labelledby", "results-name results-title");
  const view = document.getElementById("view-fly");
  let figures = null;
  let placed = { x: 0, y: 0, width: 0, height: 0 };
  /** The flight whose card the visitor has closed. */
  let closed = null;
  const isOver = () => root.classList.contains("over");
  race.on("ended", (track) => track === stage.track && nextFrame(() => isOver() || bring(first)));

  /** Puts the card beside the map for good. */
  function dock() {
    closed = stage.track;
    root.classList.remove("over");
  }
  document.addEventListener("keydown", ({ key }) => {
    if (key === "Escape" && isOver() && !document.querySelector("dialog[open], .plan-details[open]")) dock();
  });

  /**
   * Places the card over the map on the side of the last cell that has more room; without room it is beside the map.
   * While the visitor looks back, it hides from a drone that is under it.
   */
  function put({ layout, size, track, clock }) {
    const map = document.getElementById("boards").getBoundingClientRect();
    const column = clock.following ? track.last.x : track.at(clock.position)[0];
    const left = (layout.left + column * layout.cell) / size.scale;
    const right = map.width - left - layout.cell / size.scale;
    if (!clock.following && isOver()) {
      const { x, width } = placed;
      root.classList.toggle("away", x + width > map.left + left && x < map.right - right);
      return;
    }
    const width = Math.min(WIDEST, Math.max(left, right) - 2 * GAP);
    const over = !track.brought && stage.over && closed !== track && ROOMY.matches && width >= NARROWEST;
    root.classList.toggle("over", over);
    root.classList.remove("away");
    const x = left > right ? map.left + GAP : map.right - GAP - width;
    placed = { x, y: map.top + GAP, width, height: map.height - 2 * GAP };
    for (const [name, value] of Object.entries(placed))
      root.style.setProperty(`--card-${name}`, `${Math.round(value)}px`);
  }
  context.on("drawn", (drawn) => root.hidden || put(drawn));

  function draw() {
    const { track } = stage;
    const hidden = !track || !(track.done || track.past);
    if (root.hidden !== hidden) root.hidden = hidden;
    if (hidden) return;
    root.dataset.outcome = track.last.outcome;
    const { annotation, unexplained, name, last } = track;
    if (changed("reason", annotation) && annotation?.why) announce(annotation.why);
    if (changed("head", track, annotation, unexplained, name, optimumOf(track), placeOf(stage)))
      keepFocus(root, () => first.replaceChildren(...headOf(track), actionsOf(track), ...noteOf(track)));
    const { task } = stage.world;
    const told = figures?.task === task.id ? figures : null;
    if (changed("rest", track, told))
      rest.replaceChildren(efficiencyOf(last), ...(told ? [statistics(told, title(task.short_name))] : []));
    if (changed("flight", track)) meet(track);
  }

  /** Whether a part of the card depends on something else than when it was drawn: a pressed button must stay. */
  const seen = {};
  function changed(part, ...now) {
    const same = seen[part]?.every((one, i) => one === now[i]);
    seen[part] = now;
    return !same;
  }

  /** Announces the end of a flight, and asks for the statistics. */
  function meet(track) {
    const { last, live, episode, done, brought } = track;
    // The card takes the place of the pad: a tap that is on its way presses nothing.
    if (TOUCH && isOwn(track) && !brought) {
      view.inert = true;
      setTimeout(() => (view.inert = false), REST);
    }
    if (done && (live || episode)) announce(`Mission Results: ${outcome(last)}. Score ${points(last.score)}.`);
    if (!live) analyse();
  }
  race.on("ended", analyse);

  async function analyse() {
    const { id } = stage.world.task;
    const failed = ({ message }) => ({ task: id, failed: message });
    figures = await context.api.get(`analyse/${encodeURIComponent(id)}`).catch(failed);
    draw();
  }

  function headOf(track) {
    const { last, annotation, worst } = track;
    const best = optimumOf(track);
    const look = () => {
      dock();
      stage.clock.goTo(worst.first - 1);
    };
    const close = { "aria-label": "Close (Esc)", title: "Close (Esc)", press: dock };
    const see = { id: "worst", data: { key: "worst" }, title: "Show the step before it", press: look };
    return [
      el("div.panel-head", el("h2", { id: "results-name", text: "Mission Results" }), el("button.icon-button", close, icon(CROSS))),
      el("h3", { id: "results-title", text: `${track.name}: ${outcome(last)}.` }),
      el("p.hero", el("strong.hero-number", { text: points(last.score) }), best === null ? "" : el("span.hero-of", ` / ${points(best)} possible`)),
      ...pointsBar(partsOf(last, best)),
      el("p.note", { text: placeOf(stage) }),
      el("p.results-reason", { text: whyOf(track) }),
      worst && el("button.link", { ...see, text: worstOf(annotation, track.frames[worst.first].action) }),
    ].filter(Boolean);
  }

  /** At most three ways on, the first of which stands out. */
  function actionsOf(track) {
    const { annotation, worst, automatic, last, done } = track;
    const button = (id, text, press) => [el("button.button", { id, data: { key: id }, text, press })];
    const step = stepToTry(track);
    const verb = annotation?.why ? (automatic ? "Try it yourself" : "Try again") : "Try";
    const after = nextTask(context.families, stage.world.task);
    const next = after === stage.world.task ? [] : button("next", `Next: ${title(after.short_name)}`, () => goOn(context, race, acts));
    const again = () => button("again", `${verb} from ${step ? `step ${step}` : "the start"}`, () => tryAgain(context, race, acts));
    const [pilot] = race.able(stage.world.task);
    const watch = () => button("watch", `Watch ${context.pilot(pilot).name}`, () => acts.start({ pilots: [pilot] }, { play: true }));
    const delivered = last.outcome === "delivered";
    const shown = [
      ...(delivered ? next : []),
      ...(worst || (annotation?.unsolved && !delivered) ? again() : []),
      ...(isOwn(track) ? watch() : []),
      ...(isOwn(track) && (!annotation?.why || annotation.rescue_step) ? button("start-over", "Start over", acts.reset) : []),
      ...(delivered || !done ? [] : next),
    ].slice(0, MOST_BUTTONS);
    shown[0]?.classList.add("primary");
    return el("div.results-actions", ...shown);
  }

  const isOwn = ({ automatic, forkedAt }) => !automatic && forkedAt === null;
  const noteOf = (track) => (isOwn(track) && track.annotation?.rescue_step ? [el("p.note", { id: "undoes", text: UNDOES })] : []);

  stage.on("change", draw);
}

/** The parts of the final score, and what is lost of the optimum. @returns {import("./points_bar.js").Part[]} */
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
  return el(
    "div",
    { id: "efficiency-parts" },
    el("h3", { text: `Efficiency ${fixed(efficiency, 1)} of 100 (not the score)` }),
    ...parts.map(({ name, weight, share }) =>
      el("div.part", el("span", { text: title(name) }), meter(share), el("span", { text: `${fixed(weight * share, 1)} of ${weight}` })),
    ),
  );
}

/** The answer of `GET /analyse`: means, the trend, and a bar for each action. */
function statistics({ episodes, success_trend: trend, action_distribution: shares, failed, ...means }, task) {
  if (failed) return el("p.note", { text: `The statistics of this task could not be loaded: ${failed}` });
  const bar = ([action, share]) =>
    el("div.action-share", { style: { "--share": String(share) } }, el("i", { "aria-hidden": "true" }), `${action}\n${percent(share)}`);
  return el(
    "div",
    { id: "analysis" },
    el("h3", { text: `${counted(episodes, "flight")} of ${task} on this server` }),
    el(
      "dl.results-facts",
      fact("Average reward", fixed(means.average_reward)),
      fact("Average score", points(means.average_score)),
      fact("Success", percent(means.success_rate)),
      fact("Success trend", trend === null ? "–" : `${signed(trend * 100, 0)} points`),
    ),
    el("div.action-shares", { role: "group", "aria-label": "Action distribution" }, ...Object.entries(shares).map(bar)),
  );
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
