// The bar above the maps while a lesson of the tutorial is flown.
import { el, icon, toast } from "./dom.js";
import { isComplete, LESSONS, reach, reached } from "./lessons.js";
import { linkOf } from "./router.js";

/** The link to where a lesson is flown. @param {number} number From 1. */
export const lessonLink = (number) => linkOf({ ...LESSONS[number - 1].address, lesson: number }).search;

/** The goals of a lesson, those that were reached ticked. */
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

const isOver = ({ task, seed }, { address }) => task.short_name === address.task && seed === address.seed;

/**
 * @param {HTMLElement} root Empty; hidden while no lesson is flown.
 * @param {import("./context.js").Context} context
 */
export function mountLesson(root, { router, stage }) {
  root.className = "lesson-bar";
  root.setAttribute("aria-label", "Lesson");
  root.setAttribute("role", "region");
  let shown = null;
  let list, next;

  function show() {
    const number = router.address.lesson;
    const lesson = LESSONS[number - 1];
    const { world } = stage;
    root.hidden = !lesson || (world && !isOver(world, lesson));
    if (root.hidden) return;
    if (shown !== number) draw(number, lesson);
    lesson.goals.forEach(({ done }, goal) => {
      if (!world || reached(number).has(goal) || !done(stage)) return;
      reach(number, goal);
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

  function look() {
    const { lesson } = router.address;
    if (lesson > LESSONS.length) toast(`There is no lesson ${lesson}: they are 1 to ${LESSONS.length}.`);
    show();
  }

  router.on("address", look);
  stage.on("change", show);
  look();
}
