// Technical specifications: the numbers of all levels side by side, as /tasks tells them, and the legend of the map.
import { el, table } from "./dom.js";
import { fixed, title } from "./format.js";

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
const EVENTS = [
  ["Delivery", "delivery"],
  ["Step", "step"],
  ["Wait", "wait"],
  ["Above a building", "building"],
  ["Above a tree", "tree"],
  ["Above an obstacle", "obstacle"],
  ["Against the wall", "wall"],
  ["Way blocked", "blocked"],
  ["Battery empty", "battery_dead"],
];
/** What a profile pays for each event: farther from the target, as far, and closer. */
const paid = (profile) =>
  EVENTS.map(([name, event]) => [name, (t) => t.rewards[profile]?.[event]?.map((pay) => fixed(pay)).join(" / ") ?? NONE]);
const IDENTITY = [
  ["Id", (t) => t.id],
  ["Version", (t) => t.version],
  ["Grader", (t) => t.grader],
];

/** @param {HTMLElement} root An empty section. @param {import("./context.js").Context} context */
export function mount(root, context) {
  const frame = el("div.scroller", { tabindex: "0", role: "region", "aria-label": "Table of specifications" });
  const show = (family) => frame.replaceChildren(specifications(title(family), context.families.get(family)));
  const families = [...context.families.keys()];
  const choices = families.map((family, i) =>
    el(
      "label.segment",
      el("input", { type: "radio", name: "specs-family", checked: i === 0, on: { change: () => show(family) } }),
      el("span", { text: title(family) }),
    ),
  );
  root.append(
    el(
      "div.view-head",
      el("h2", { text: "Technical specifications" }),
      el("fieldset.segments", el("legend.visually-hidden", { text: "Levels" }), ...choices),
    ),
    frame,
    legend(context.kinds),
  );
  show(families[0]);
}

function specifications(family, tasks) {
  const columns = [["Level"], ...tasks.map((task) => [title(task.short_name)])];
  return table(
    "table.table.specs-table",
    {},
    `Technical specifications of the ${family} levels`,
    columns,
    group("World", WORLD, tasks),
    ...Object.keys(tasks[0].rewards)
      .filter((profile) => Object.keys(tasks[0].rewards[profile]).length)
      .map((profile) => group(`Rewards per step (${profile}): farther / as far / closer`, paid(profile), tasks)),
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

/** What stands on a map, and what it does to the drone. */
function legend(kinds) {
  return el(
    "section.legend",
    { "aria-labelledby": "legend-title" },
    el("h2", { id: "legend-title", text: "Legend" }),
    el(
      "dl",
      ...kinds.map((kind) =>
        el(
          "div",
          el("dt", el("span.emoji", { "aria-hidden": "true", text: kind.emoji }), kind.name),
          el("dd", { text: kind.effect }),
        ),
      ),
    ),
  );
}
