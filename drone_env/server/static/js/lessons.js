// The tutorial: three flights over fixed maps, which index.html describes; their goals, and the bar of the present lesson.
import { recall, remember } from "./base.js";
import { el, icon, toast } from "./dom.js";

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

/** The numbers of the lessons. */
export const LESSONS = GOALS.map((_, i) => i + 1);

const key = (number) => `drone-env-lesson-${number}`;

/** The indices of the goals that were reached. @param {number} number From 1. */
export const reached = (number) => new Set([...(recall(key(number)) ?? "")].map(Number));

export const isComplete = (number) => GOALS[number - 1].every((_, goal) => reached(number).has(goal));

/** The card of a lesson: its title, text, goals and link. The numbers in its text are exact. @param {number} number From 1. */
export function lessonCard(number) {
  const card = document.importNode(document.getElementById("lessons").content.children[number - 1], true);
  card.querySelectorAll("li").forEach((goal, i) => mark(goal, reached(number).has(i)));
  return card;
}

/** @param {HTMLElement} goal @param {boolean} is Whether it is reached. */
function mark(goal, is) {
  goal.dataset.reached = is ? "yes" : "no";
  goal.replaceChildren(
    icon(is ? "M5 12.5l4.5 4.5L19 7.5" : "M12 5a7 7 0 1 0 .01 0z"),
    el("span.visually-hidden", { text: is ? "Reached: " : "Goal: " }),
    goal.lastChild,
  );
}

/** @param {HTMLElement} root @param {Context} context */
export function mountLesson(root, { router, stage }) {
  root.setAttribute("aria-label", "Lesson");
  root.setAttribute("role", "region");
  let shown = null;
  let list, next, flight;

  function show() {
    const number = router.address.lesson;
    const goals = GOALS[number - 1];
    const { world } = stage;
    root.hidden = !goals;
    if (goals && shown !== number) draw(number);
    if (goals && world) root.hidden = world.task.short_name !== flight.get("task") || String(world.seed) !== flight.get("seed");
    if (root.hidden) return;
    goals.forEach((isDone, goal) => {
      if (!world || reached(number).has(goal) || !isDone(stage)) return;
      remember(key(number), [...reached(number), goal].join(""));
      mark(list.children[goal], true);
    });
    next.hidden = number === LESSONS.length || !isComplete(number);
  }

  function draw(number) {
    shown = number;
    const [head, text, goals, link] = lessonCard(number).children;
    flight = new URLSearchParams(link.getAttribute("href"));
    list = goals;
    list.setAttribute("aria-live", "polite");
    const after = number < LESSONS.length ? lessonCard(number + 1).querySelector("a").getAttribute("href") : "";
    next = el("a.button.small.primary", { href: after, text: "Next lesson" });
    const back = el("a.button.small", { href: "?view=learn", text: "Back to Learn" });
    root.replaceChildren(
      el("h2", { text: `Lesson ${number}: ${head.textContent}` }),
      text,
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
