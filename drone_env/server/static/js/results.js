// The mission results of a finished flight: outcome, why it failed, another try, worst move, efficiency, statistics and the next task.
import { nextFrame, TOUCH } from "./base.js";
import { announce, bring, el, leaveFocus, setText } from "./dom.js";
import { counted, fixed, isLost, outcome, percent, points, scoring, signed, title } from "./format.js";
import { placeOf } from "./standings.js";
import { writeProvenance } from "./track.js";

/** Milliseconds without taps after the end of a flight by hand. */
const REST = 700;

/** @param {HTMLElement} root @param {Context} context @param {Race} race */
export function mountResults(root, context, race, acts) {
  const { stage } = context;
  const head = el("h2", { id: "results-title" });
  const why = el("p.note");
  const place = el("p.strip-reason");
  const counts = el("p.note");
  const before = () => stage.clock.goTo(stage.track.worst.step - 1);
  const see = el("button.link", { id: "worst", title: "Show the step before this move", press: before });
  const tryIt = el("button.button.small", {
    id: "try-worst",
    press: () => {
      before();
      acts.fork();
    },
  });
  const worstLine = el("div.strip-worst", see, tryIt);
  const again = el("button.button.primary", { id: "again", "aria-describedby": "undoes", press: () => tryAgain(context, race, acts) });
  const afresh = el("button.button", { id: "start-over", text: "Start over", press: acts.reset });
  const watch = el("button.button", {
    id: "watch",
    press: () => acts.start({ pilots: [stage.track.annotation.network] }, { play: true }),
  });
  const undoes = el("p.note", { id: "undoes", text: "Trying again counts as Undo: not listed, not kept as your best." });
  const next = el("button.button.primary", { id: "next", press: () => goOn(context, race, acts) });
  const efficiency = el("p.note.strip-efficiency", { id: "efficiency-parts" });
  const analysis = el("p.note.strip-analysis");
  const reason = el("p.strip-reason");
  const more = el("details", el("summary.note", { text: "More about this flight" }), efficiency, analysis);
  const first = el("div.strip-first", head, place, reason, el("div.strip-actions", again, next, afresh, watch), undoes);
  root.append(first, why, counts, worstLine, more);
  const view = document.getElementById("view-fly");
  let announced = null;
  race.on("ended", (track) => track === stage.track && nextFrame(() => bring(first)));

  function draw() {
    const { track } = stage;
    const hidden = !track || !(track.done || track.past);
    if (root.hidden !== hidden) root.hidden = hidden;
    if (hidden) return;
    const { last, annotation, worst } = track;
    root.dataset.outcome = last.outcome;
    setText(head, `${track.name}: ${outcome(last)}.`);
    setText(why, summary(stage, track));
    setText(place, placeOf(stage));
    setText(counts, scoring(stage.world.task));
    if (annotation?.why && reason.textContent !== annotation.why) announce(annotation.why);
    setText(reason, annotation?.why ?? "");
    again.hidden = !annotation?.why;
    if (!again.hidden) {
      const step = annotation.rescue_step ? `step ${annotation.rescue_step}` : "the start";
      setText(again, track.automatic ? `Try it yourself from ${step}` : `Try again from ${step}`);
    }
    const own = !track.automatic && track.forkedAt === null;
    undoes.hidden = !own || !annotation?.rescue_step;
    afresh.hidden = !own || (!again.hidden && undoes.hidden);
    watch.hidden = !own || !annotation?.network;
    if (!watch.hidden) setText(watch, `Watch ${context.pilot(annotation.network).name}`);
    setText(efficiency, efficiencyOf(last));
    worstLine.hidden = !worst || !isLost(worst.regret);
    tryIt.hidden = !again.hidden;
    if (worst) {
      setText(tryIt, `Try from step ${worst.step - 1}`);
      const best = `best: ${worst.best_actions.join(" or ")}, ${annotation.worst_why}`;
      setText(see, `Worst move: step ${worst.step}, ${worst.action}, lost ${points(worst.regret)}; ${best}`);
    }
    const after = nextTask(context.families, stage.world.task);
    setText(next, `Next: ${title(after.short_name)}`);
    next.hidden = last.outcome !== "delivered" || after === stage.world.task;
    if (announced === track) return;
    // The card takes the place of the pad: a tap that is on its way presses nothing.
    if (TOUCH && own && !track.brought) {
      view.inert = true;
      setTimeout(() => (view.inert = false), REST);
    }
    announced = track;
    analysis.hidden = Boolean(track.past);
    if (!track.past) analyse(stage.world.task);
    if (track.done && (track.live || track.episode)) announce(`${outcome(last)}. Score ${points(last.score)}.`);
  }

  async function analyse(task) {
    setText(analysis, "Loading the statistics of this task …");
    try {
      const figures = await context.api.get(`analyse/${encodeURIComponent(task.id)}`);
      if (stage.world.task === task) setText(analysis, inWords(figures, task));
    } catch (error) {
      setText(analysis, `The statistics of this task could not be loaded: ${error.message}`);
    }
  }

  stage.on("change", draw);
}

/** The efficiency with its parts: `Efficiency 87.5 of 100: parcels 100 % (weight 75), ...`. */
function efficiencyOf({ efficiency, efficiency_parts: parts }) {
  const words = parts.map(({ name, weight, share }) => `${title(name).toLowerCase()} ${percent(share)} (weight ${weight})`);
  return `Efficiency (not the score) ${fixed(efficiency, 1)} of 100: ${words.join(", ")}.`;
}

function summary({ world }, { last, annotation, steps, done }) {
  if (!done) return "This flight is not finished, so its moves have no marks.";
  const optimum = annotation?.optimal_score ?? null;
  const parts = [`Score ${points(last.score)}${optimum === null ? "" : ` of ${points(optimum)} possible`}`];
  if (annotation) parts.push(isLost(annotation.regret) ? `lost ${points(annotation.regret)}` : "nothing lost");
  parts.push(`${last.deliveries_done} of ${counted(world.parcels.length, "parcel")}`);
  parts.push(`${last.battery_units} battery units after ${steps} steps`);
  if (annotation) parts.push(`a best flight ends with ${annotation.optimal_battery} after ${annotation.optimal_steps} steps`);
  return `${parts.join(", ")}.`;
}

function inWords(figures, task) {
  const trend = figures.success_trend === null ? "" : ` (trend ${signed(figures.success_trend * 100, 0)} points)`;
  const shares = Object.entries(figures.action_distribution).map(([action, share]) => `${action} ${percent(share)}`);
  const means = [
    `score ${points(figures.average_score)}`,
    `lost ${points(figures.mean_regret)}`,
    `reward ${fixed(figures.average_reward)}`,
    `${fixed(figures.average_steps, 1)} steps`,
    `success ${percent(figures.success_rate)}${trend}`,
  ];
  return `${counted(figures.episodes, "flight")} of ${title(task.short_name)} here, on average: ${[...means, ...shares].join(", ")}.`;
}

/** The next task of the family, or the last one again. Only the standard ones begin again: Easy, Medium, Hard, Easy. */
function nextTask(families, task) {
  const group = families.get(task.family);
  return group[group.indexOf(task) + 1] ?? (task.family === "standard" ? group[0] : task);
}

/** Continues a failed flight from the last step at which all parcels could still be delivered. @param {Context} context @param {Race} race */
function tryAgain({ stage }, race, acts) {
  const { annotation, automatic, provenance, forkedAt } = stage.track;
  const step = annotation.rescue_step ?? 0;
  leaveFocus();
  if (automatic || forkedAt !== null) {
    stage.clock.goTo(step);
    acts.fork();
  } else if (step === 0) acts.reset();
  else {
    // The record notes that moves were taken back.
    const of = writeProvenance({ ...provenance, person: null, undo_used: true });
    acts.start({ of, actions: stage.track.lettersTo(step) });
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
