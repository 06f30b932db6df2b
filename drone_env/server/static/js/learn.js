// Learn: what this is, the tutorial, and all numbers of the tasks.
import { el, table } from "./dom.js";
import { cellName, fixed, title } from "./format.js";
import { ABOUT } from "./help.js";
import { LESSONS, goalList, isComplete, lessonLink, reached } from "./lessons.js";

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

const NONE = "–";
const drains = (drain) =>
  Object.entries(drain)
    .map(([kind, units]) => `; ${units} above a ${kind}`)
    .join("");

/** A row each: its name, and what stands in it for a task. Rows of nothing but dashes are left out. */
const WORLD = [
  ["Grid", (t) => `${t.width} × ${t.height}`],
  ["Parcels", (t) => t.deliveries],
  ["Buildings", (t) => t.buildings],
  ["Trees", (t) => t.trees],
  ["Obstacles", (t) => t.obstacles],
  ["Charging pads", (t) => (t.pads ? `${t.pads}, +${t.charge_rate} units a wait` : NONE)],
  ["Cannot be entered", (t) => t.impassable.join(", ") || NONE],
  ["Steps at most", (t) => t.max_steps],
  ["Battery", (t) => `${t.battery_capacity} units`],
  ["A step drains", (t) => `1 unit${drains(t.drain)}`],
];
const IDENTITY = [
  ["Id", (t) => t.id],
  ["Version", (t) => t.version],
  ["Grader", (t) => t.grader],
];
/** What a reward profile pays on every task, beside its events. */
const always = ({ shaping, clamp, shaping_gamma, pays_score }) =>
  [
    shaping ? `${fixed(shaping)} for each cell closer` : "",
    clamp ? `${fixed(clamp[0])} to ${fixed(clamp[1])} a step` : "",
    shaping_gamma === null ? "" : `shaping by potential, discounted by ${fixed(shaping_gamma)}`,
    pays_score ? "the score at the end" : "",
  ].filter(Boolean);
/** What a profile pays for each event: farther from the target, as far, and closer. */
const paid = (profile, { rewards }) =>
  Object.keys(rewards[profile]).map((event) => [
    title(event),
    (t) => t.rewards[profile]?.[event]?.map((pay) => fixed(pay)).join(" / ") ?? NONE,
  ]);

/** The numbers of all tasks side by side as /tasks tells them. @param {import("./context.js").Context} context @returns {HTMLElement[]} */
function specifications({ families, rewardProfiles, kinds }) {
  const numbers = el("div.scroller", { tabindex: "0", role: "region", "aria-label": "Table of specifications" });
  const show = (family) => numbers.replaceChildren(ofTasks(title(family), families.get(family)));
  const choices = [...families.keys()].map((family, i) =>
    el(
      "label.segment",
      el("input", { type: "radio", name: "specs-family", checked: i === 0, on: { change: () => show(family) } }),
      el("span", { text: title(family) }),
    ),
  );
  show(families.keys().next().value);
  return [
    el(
      "div.view-head",
      el("h2", { text: "Technical specifications" }),
      el("fieldset.segments", el("legend.visually-hidden", { text: "Tasks" }), ...choices),
    ),
    numbers,
    glossary(
      "Reward profiles",
      rewardProfiles.map((profile) => [el("dt", { text: profile.id }), profile.summary, always(profile).join("; ")]),
    ),
    glossary(
      "Legend",
      kinds.map(({ emoji, name, effect }) => [
        el("dt", el("span.emoji", { "aria-hidden": "true", text: emoji }), cellName(name)),
        effect,
      ]),
    ),
  ];
}

function ofTasks(family, tasks) {
  const profiles = Object.keys(tasks[0].rewards).filter((profile) => Object.keys(tasks[0].rewards[profile]).length);
  return table(
    "table.table.specs-table",
    {},
    `Technical specifications of the ${family} tasks`,
    [["Task"], ...tasks.map((task) => [title(task.short_name)])],
    group("World", WORLD, tasks),
    ...profiles.map((profile) =>
      group(`Rewards by event (${profile}): farther / as far / closer`, paid(profile, tasks[0]), tasks),
    ),
    group("Identity", IDENTITY, tasks),
  );
}

function group(name, rows, tasks) {
  const filled = rows
    .map(([label, cell]) => [label, tasks.map((task) => String(cell(task)))])
    .filter(([, values]) => values.some((value) => value !== NONE));
  return el(
    "tbody",
    el("tr.group", el("th", { scope: "rowgroup", colspan: tasks.length + 1, text: name })),
    ...filled.map(([label, values]) =>
      el("tr", el("th", { scope: "row", text: label }), ...values.map((value) => el("td", { text: value }))),
    ),
  );
}

/** A section of terms, each with what is said of it. */
function glossary(name, entries) {
  const entry = ([term, ...said]) => el("div", term, ...said.map((text) => el("dd", { text })));
  return el("section.glossary", { "aria-label": name }, el("h2", { text: name }), el("dl", ...entries.map(entry)));
}
