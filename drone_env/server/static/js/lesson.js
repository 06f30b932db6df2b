// The bar above the maps while a lesson of the tutorial is flown.
import { announce, el, icon } from "./dom.js";
import { isComplete, LESSONS, reach, reached } from "./lessons.js";
import { linkTo } from "./link.js";

/** Where a lesson is flown. @param {number} number From 1. */
export const lessonAddress = (number) => ({ ...LESSONS[number - 1].address, lesson: number });

/** The goals of a lesson, those that were reached ticked. */
export function goalList(number) {
  const item = ({ text }, goal) => {
    const is = reached(number).has(goal);
    return el(
      "li",
      { data: { reached: is ? "yes" : "no" } },
      icon(is ? "M5 12.5l4.5 4.5L19 7.5" : "M12 5a7 7 0 1 0 .01 0z"),
      el("span.visually-hidden", { text: is ? "Reached: " : "Goal: " }),
      text,
    );
  };
  return el("ul.goals", ...LESSONS[number - 1].goals.map(item));
}

/**
 * @param {HTMLElement} root Empty; hidden where the address names no lesson.
 * @param {import("./context.js").Context} context
 */
export function mountLesson(root, { router, stage, tasks }) {
  root.className = "lesson-bar";
  root.setAttribute("aria-label", "Lesson");
  const number = () => Number(router.address.lesson);

  function show() {
    const n = number();
    const lesson = LESSONS[n - 1];
    root.hidden = !lesson;
    if (!lesson) return root.replaceChildren();
    const next = n < LESSONS.length && isComplete(n);
    root.replaceChildren(
      el("h2", { text: `Lesson ${n}: ${lesson.title}` }),
      el("p", { text: lesson.text }),
      goalList(n),
      el(
        "p.lesson-ways",
        next ? linkTo(router, "a.button.small.primary", lessonAddress(n + 1), "Next lesson") : null,
        linkTo(router, "a.button.small", { view: "learn" }, "Back to Learn"),
      ),
    );
  }

  /** Ticks what the flights over the lesson's map have reached now. */
  function look() {
    const n = number();
    const lesson = LESSONS[n - 1];
    if (!lesson || !flies(stage.world, lesson.address)) return;
    const fresh = lesson.goals.flatMap(({ done }, goal) => (!reached(n).has(goal) && done(stage) ? [goal] : []));
    for (const goal of fresh) reach(n, goal);
    if (!fresh.length) return;
    show();
    announce(isComplete(n) ? "All goals of the lesson are reached." : `Reached: ${lesson.goals[fresh.at(-1)].text}`);
  }

  const flies = (world, { task, seed }) => {
    const id = tasks.find(({ short_name }) => short_name === task)?.id;
    return world?.seed === seed && [id, task].includes(world.task);
  };
  router.on("address", show);
  stage.on("change", look);
  show();
}
