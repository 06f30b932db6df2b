// Learn: what this is, the tutorial, and all numbers of the tasks.
import { el } from "./dom.js";
import { ABOUT } from "./help.js";
import { goalList, lessonLink } from "./lesson.js";
import { isComplete, LESSONS, reached } from "./lessons.js";
import { specifications } from "./specs.js";

const MORE =
  " The score counts parcels first, then battery and steps left. Every flight stands beside the exact optimum of its " +
  "map: what a move has lost can never be won back.";

/** @param {HTMLElement} root An empty section. @param {import("./context.js").Context} context */
export function mount(root, context) {
  const lessons = el("ol.lessons");
  root.append(el("h2", { text: "Learn" }), el("p.about", { text: ABOUT + MORE }), lessons, ...specifications(context));
  context.on("view", (view) => {
    if (view !== "learn") return;
    const next = LESSONS.findIndex((_, i) => !isComplete(i + 1));
    lessons.replaceChildren(...LESSONS.map((_, i) => card(i + 1, i === next)));
  });
}

function card(number, isNext) {
  const { title, text } = LESSONS[number - 1];
  const way = isComplete(number) ? "Fly again" : reached(number).size ? "Go on" : "Begin";
  return el(
    "li.lesson",
    el("h3", { text: `${number}. ${title}` }),
    el("p", { text }),
    goalList(number),
    el(isNext ? "a.button.primary" : "a.button", {
      href: lessonLink(number),
      text: way,
      "aria-label": `${way}: ${title}`,
    }),
  );
}
