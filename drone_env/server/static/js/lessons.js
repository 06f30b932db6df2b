// The tutorial: three flights over fixed maps, their goals, and the bar of the present lesson.
import { recall, remember } from "./base.js";
import { el, icon, toast } from "./dom.js";
import { linkOf } from "./router.js";

const by = (pilot, { tracks }) => tracks.filter((track) => track.pilot === pilot);
/** A goal for any flight of the visitor. */
const mine = (test) => (stage) => by("human", stage).some(test);

const delivers = (track) => track.last.outcome === "delivered";
/** Whether a flight has ended and lost at most this score. */
const losesAtMost = (most) => (track) => track.done && track.last.regret !== null && track.last.regret <= most;
const charges = ({ frames }) =>
  frames.some(({ action, battery_units }, i) => action === "WAIT" && battery_units > frames[i - 1].battery_units);

/** Whether the page shows the step before the worst move of this pilot, and does not play. */
function beforeWorst({ track, clock }, pilot) {
  return track?.pilot === pilot && !clock.playing && clock.cursor === track.worst?.first - 1;
}

/** @type {Lesson[]} */
export const LESSONS = [
  {
    title: "Fly yourself",
    text:
      "You are the pilot. The arrow keys, W A S D or a swipe on the map move the drone by one cell. Fly it " +
      "to the parcel. Each move takes a step and a unit of battery, so a detour loses points. The optimum of this " +
      "map takes 8 moves.",
    address: { view: "fly", task: "easy", seed: 18, pilots: ["human"] },
    goals: [
      { text: "Make a move", done: mine((track) => track.last.step > 0) },
      { text: "Deliver the parcel", done: mine(delivers) },
      { text: "Lose nothing: 8 moves", done: mine(losesAtMost(0)) },
    ],
  },
  {
    title: "See what a move loses",
    text:
      "Greedy always flies to the nearest parcel. The optimum of this map is 96.8; Greedy scores 53.3, " +
      "and loses the difference in a single move. Let it fly, then click the red dot in the graph: the score falls " +
      "with that move. Go one step back (←): the drone is above a pad, and waiting charges the battery. " +
      "Press Try from here, wait twice (Space), and fly on.",
    address: { view: "fly", task: "skyline_easy", seed: 88, pilots: ["greedy"] },
    goals: [
      { text: "Let Greedy finish", done: (stage) => by("greedy", stage).some((track) => track.done) },
      { text: "Go to the step before its blunder", done: (stage) => beforeWorst(stage, "greedy") },
      {
        text: "Try from there and deliver all parcels",
        done: mine((track) => track.provenance.parent !== null && delivers(track)),
      },
    ],
  },
  {
    title: "Plan the battery",
    text:
      "In Skyline one battery is not enough for the tour. It holds 11 units here. A step takes 1 unit, 2 above a tree " +
      "and 3 above a building; obstacles block the way. Battery range (B) shows the cells in reach. " +
      "On a pad, each wait (Space) charges 4 units. Without charging, you cannot deliver more than two of the " +
      "three parcels.",
    address: { view: "fly", task: "skyline_easy", seed: 84, pilots: ["human"] },
    goals: [
      { text: "Charge: wait on a pad", done: mine(charges) },
      { text: "Deliver all three parcels", done: mine(delivers) },
      { text: "Lose at most 2 points", done: mine(losesAtMost(0.02)) },
    ],
  },
];

const key = (number) => `drone-env-lesson-${number}`;

/** The indices of the goals that were reached. @param {number} number From 1. */
export const reached = (number) => new Set([...(recall(key(number)) ?? "")].map(Number));

export const isComplete = (number) => LESSONS[number - 1].goals.every((_, goal) => reached(number).has(goal));

/** The link to a lesson. @param {number} number From 1. */
export const lessonLink = (number) => linkOf({ ...LESSONS[number - 1].address, lesson: number }).search;

export const goalList = (number) =>
  el("ul.goals", ...LESSONS[number - 1].goals.map((_, goal) => goalItem(number, goal)));

function goalItem(number, goal) {
  const is = reached(number).has(goal);
  return el(
    "li",
    { data: { reached: is ? "yes" : "no" } },
    icon(is ? "M5 12.5l4.5 4.5L19 7.5" : "M12 5a7 7 0 1 0 .01 0z"),
    el("span.visually-hidden", { text: is ? "Reached: " : "Goal: " }),
    LESSONS[number - 1].goals[goal].text,
  );
}

/** @param {HTMLElement} root @param {Context} context */
export function mountLesson(root, { router, stage }) {
  root.setAttribute("aria-label", "Lesson");
  root.setAttribute("role", "region");
  let shown = null;
  let list, next;

  function show() {
    const number = router.address.lesson;
    const lesson = LESSONS[number - 1];
    const { world } = stage;
    const { task, seed } = lesson?.address ?? {};
    root.hidden = !lesson || (world && (world.task.short_name !== task || world.seed !== seed));
    if (root.hidden) return;
    if (shown !== number) draw(number, lesson);
    lesson.goals.forEach(({ done }, goal) => {
      if (!world || reached(number).has(goal) || !done(stage)) return;
      remember(key(number), [...reached(number), goal].join(""));
      list.children[goal].replaceWith(goalItem(number, goal));
    });
    next.hidden = !LESSONS[number] || !isComplete(number);
  }

  function draw(number, { title, text }) {
    shown = number;
    list = goalList(number);
    list.setAttribute("aria-live", "polite");
    next = el("a.button.small.primary", { href: LESSONS[number] ? lessonLink(number + 1) : "", text: "Next lesson" });
    const back = el("a.button.small", { href: "?view=learn", text: "Back to Learn" });
    root.replaceChildren(
      el("h2", { text: `Lesson ${number}: ${title}` }),
      el("p", { text }),
      list,
      el("p.lesson-ways", next, back),
    );
  }

  function follow() {
    const { lesson } = router.address;
    if (lesson > LESSONS.length) toast(`There is no lesson ${lesson}: the lessons are 1 to ${LESSONS.length}.`);
    show();
  }

  router.on("address", follow);
  stage.on("change", show);
  follow();
}
