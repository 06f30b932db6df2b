// Learn: a short introduction, the tutorial, and the numbers of the tasks.
import { el, scroller, table } from "./dom.js";
import { cellName, fixed, title } from "./format.js";
import { drawSign } from "./legend.js";
import { LESSONS, isComplete, lessonCard, reached } from "./lessons.js";

const MORE =
  " The score counts parcels first, then the battery and the steps left. The page compares every flight with the " +
  "exact optimum of its map. A move that loses points loses them for good.";

/** @param {HTMLElement} root @param {Context} context */
export function mountLearn(root, context) {
  const lessons = el("ol.lessons");
  root.append(el("h2", { text: "Learn" }), el("p.about", { text: document.getElementById("about").textContent + MORE }), lessons);
  root.append(el("div.view-head", el("h2", { text: "Technical specifications" })));
  for (const family of context.families.keys()) root.append(specifications(context, family));
  root.append(legend(context));
  context.on("view", (view) => {
    if (view !== "learn") return;
    const next = LESSONS.find((number) => !isComplete(number));
    lessons.replaceChildren(...LESSONS.map((number) => card(number, number === next)));
  });
}

function card(number, isNext) {
  const card = lessonCard(number);
  const title = card.querySelector("h3");
  const link = card.querySelector("a");
  link.classList.toggle("primary", isNext);
  link.textContent = isComplete(number) ? "Fly again" : reached(number).size ? "Continue" : "Begin";
  link.ariaLabel = `${link.textContent}: ${title.textContent}`;
  title.prepend(`${number}. `);
  return card;
}

const NONE = "–";
const drains = (drain) =>
  Object.entries(drain)
    .filter(([, units]) => units !== 1)
    .map(([kind, units]) => `; ${units} above a ${kind}`)
    .join("");

/** The rows: a name, and the value of a task. */
const WORLD = [
  ["Id", (t) => t.id],
  ["Grid", (t) => `${t.width} × ${t.height}`],
  ["Parcels", (t) => t.deliveries],
  ["Buildings", (t) => t.buildings ?? "varies"],
  ["Trees", (t) => t.trees ?? "varies"],
  ["Obstacles", (t) => t.obstacles ?? "varies"],
  ["Charging pads", (t) => (t.pads ? `${t.pads}, +${t.charge_rate} units per wait` : NONE)],
  ["Blocked cells", (t) => t.impassable.join(", ") || NONE],
  ["Maximum steps", (t) => t.max_steps],
  ["Battery", (t) => `${t.battery_capacity} units`],
  ["Battery use per step", (t) => `1 unit${drains(t.drain)}`],
];
const PROFILE = "tiered";
/** The reward of each event if the step moves away from the target, keeps the distance, or moves closer. */
const rewardRows = (rewards) =>
  Object.keys(rewards).map((event) => [
    title(event),
    (t) => t.rewards[PROFILE][event].map((reward) => fixed(reward)).join(" / "),
  ]);

/** The numbers of the tasks of a family side by side, from `GET /tasks`. @param {Context} context @param {string} family */
export function specifications({ families }, family) {
  const tasks = families.get(family);
  const caption = `Technical specifications of the ${title(family)} tasks`;
  const numbers = [
    group("World", WORLD, tasks),
    group("Reward of a step: farther / same distance / closer", rewardRows(tasks[0].rewards[PROFILE]), tasks),
  ];
  const names = tasks.map((task) => [title(task.short_name)]);
  return scroller(caption, table("table.table.specs-table", {}, caption, [[title(family)], ...names], ...numbers));
}

function group(name, rows, tasks) {
  const row = ([label, value]) =>
    el("tr", el("th", { scope: "row", text: label }), ...tasks.map((task) => el("td", { text: String(value(task)) })));
  return el(
    "tbody",
    el("tr.group", el("th", { scope: "rowgroup", colspan: tasks.length + 1, text: name })),
    ...rows.map(row),
  );
}

function legend({ kinds }) {
  const entry = ({ name, effect }) => el("div", el("dt", drawSign(name), cellName(name)), el("dd", { text: effect }));
  const shown = kinds.filter(({ name }) => name !== "unknown");
  return el("section.glossary", { "aria-label": "Legend" }, el("h2", { text: "Legend" }), el("dl", ...shown.map(entry)));
}
