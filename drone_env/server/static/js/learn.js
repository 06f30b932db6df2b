// Learn: a short introduction, the tutorial, and the numbers of the tasks.
import { el, scroller, table } from "./dom.js";
import { cellName, fixed, title } from "./format.js";
import { drawSign } from "./legend.js";
import { lessonCards } from "./lessons.js";

/** @param {HTMLElement} root @param {Context} context */
export function mountLearn(root, context) {
  root.append(document.getElementById("learn").content);
  root.querySelector(".about").prepend(document.getElementById("about").textContent);
  root.querySelector(".all-specifications").append(...[...context.families.keys()].map((family) => specifications(context, family)));
  const entry = ({ name, effect }) => el("div", el("dt", drawSign(name), cellName(name)), el("dd", { text: effect }));
  root.querySelector("dl").append(...context.kinds.filter(({ name }) => name !== "unknown").map(entry));
  context.on("view", (view) => view === "learn" && root.querySelector("ol").replaceChildren(...lessonCards()));
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
