// The tutorial: three flights over fixed maps, which index.html describes; their goals, and the bar of the present lesson.
import { recall, remember } from "./base.js";
import { toast } from "./dom.js";

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

/** The tests of the goals of each lesson, at most ten. */
const GOALS = [
  [mine((track) => track.last.step > 0), mine(delivers), mine(losesAtMost(0))],
  [
    (stage) => by("greedy", stage).some((track) => track.done),
    (stage) => beforeWorst(stage, "greedy"),
    mine((track) => track.provenance.parent !== null && delivers(track)),
  ],
  [mine(charges), mine(delivers), mine(losesAtMost(0.02))],
];

const key = (number) => `drone-env-lesson-${number}`;

/** The indices of the goals that were reached. @param {number} number From 1. */
const reached = (number) => new Set([...(recall(key(number)) ?? "")].map(Number));

/** The cards of the lessons: title, text, goals and link. The numbers in their texts are exact. */
export function lessonCards() {
  const cards = [...document.importNode(document.getElementById("lessons").content, true).children];
  cards.forEach((card, i) => {
    const done = reached(i + 1);
    card.querySelectorAll("li").forEach((goal, i) => (goal.dataset.reached = String(done.has(i))));
  });
  return cards;
}

/** The bar of the lesson that the address names. @param {HTMLElement} root @param {Context} context */
export function mountLesson(root, { router, stage }) {
  Object.assign(root, { role: "region", ariaLabel: "Lesson" });
  let [drawn, flight, next] = [null, null, null];

  function show() {
    const number = router.address.lesson;
    const goals = GOALS[number - 1];
    const { world } = stage;
    if (goals && drawn !== number) draw(number);
    root.hidden = !goals || (world !== null && (world.task.short_name !== flight.get("task") || String(world.seed) !== flight.get("seed")));
    if (root.hidden || !world) return;
    const marks = root.querySelectorAll("li");
    goals.forEach((isDone, goal) => {
      if (marks[goal].dataset.reached === "true" || !isDone(stage)) return;
      marks[goal].dataset.reached = "true";
      remember(key(number), [...reached(number), goal].join(""));
    });
    next.hidden = number === GOALS.length || !goals.every((_, goal) => reached(number).has(goal));
  }

  function draw(number) {
    drawn = number;
    const [card, after] = lessonCards().slice(number - 1);
    root.replaceChildren(...card.children);
    next = root.querySelector("a");
    flight = new URL(next.href).searchParams;
    if (after) next.href = after.querySelector("a").href;
    next.classList.add("primary");
    next.ariaLabel = next.textContent = "Next lesson";
  }

  function follow() {
    const { lesson } = router.address;
    if (lesson > GOALS.length) toast(`There is no lesson ${lesson}: the lessons are 1 to ${GOALS.length}.`);
    show();
  }

  router.on("address", follow);
  stage.on("change", show);
  follow();
}
