/**
 * Technical specifications: the numbers of all levels side by side, as `/tasks` tells them, and the legend of the map.
 */

/** @typedef {(task: object) => string|number} Cell */

const dash = "–";
const names = (list) => list.join(", ") || "nothing";
const drains = (drain) => Object.entries(drain).map(([kind, units]) => `${units} above a ${kind}`).join(", ");

/** What stands in the table, a row each; a row in which every level has a dash is left out. @type {[string, Cell][]} */
const ROWS = [
  ["Grid", (t) => `${t.width} × ${t.height}`],
  ["Parcels", (t) => t.deliveries],
  ["Buildings", (t) => t.buildings],
  ["Trees", (t) => t.trees],
  ["Obstacles", (t) => t.obstacles],
  ["Charging pads", (t) => (t.pads ? `${t.pads}, +${t.charge_rate} a wait` : dash)],
  ["Cannot be entered", (t) => names(t.impassable)],
  ["Steps at most", (t) => t.max_steps],
  ["Battery", (t) => `${t.battery_capacity} units`],
  ["A step drains", (t) => (Object.keys(t.drain).length ? `1 unit; ${drains(t.drain)}` : "1 unit")],
];

const REWARDS = [
  ["Delivery", "r_delivery"],
  ["Step", "r_step"],
  ["Wait", "r_wait"],
  ["Above a building", "r_building"],
  ["Above a tree", "r_tree"],
  ["Above an obstacle", "r_obstacle"],
  ["Against the wall", "r_wall"],
  ["Way blocked", "r_blocked"],
  ["Battery dead", "r_battery_dead"],
];

const IDENTITY = [
  ["Id", (t) => t.id],
  ["Version", (t) => t.version],
  ["Grader", (t) => t.grader],
];

/**
 * @param {HTMLElement} root Empty section.
 * @param {object} context Of the page.
 */
export function mount(root, context) {
  const families = [
    ["Delivery", context.tasks.filter((task) => task.published)],
    ["Skyline", context.tasks.filter((task) => !task.published)],
  ].filter(([, tasks]) => tasks.length);
  const frame = document.createElement("div");
  frame.className = "specs-table";
  const show = ([family, tasks]) => frame.replaceChildren(table(family, tasks));
  show(families[0]);
  root.append(familySwitch(families, show), frame, legend(context.kinds));
}

/** Radio buttons that choose whose numbers are shown. */
function familySwitch(families, show) {
  const group = document.createElement("fieldset");
  group.className = "switch";
  const caption = document.createElement("legend");
  caption.textContent = "Levels";
  group.append(caption);
  families.forEach((family, index) => {
    const label = document.createElement("label");
    const choice = document.createElement("input");
    choice.type = "radio";
    choice.name = "specs-family";
    choice.checked = index === 0;
    choice.addEventListener("change", () => show(family));
    label.append(choice, ` ${family[0]}`);
    group.append(label);
  });
  return group;
}

function table(family, tasks) {
  const made = document.createElement("table");
  const caption = made.createCaption();
  caption.className = "visually-hidden";
  caption.textContent = `Technical specifications of the ${family} levels`;
  const head = made.createTHead().insertRow();
  head.append(heading("col", "Level"), ...tasks.map((task) => heading("col", task.short_name)));
  group(made, "World", ROWS, tasks);
  group(made, "Rewards (tiered)", REWARDS.map(([name, key]) => [name, (task) => task[key].toFixed(2)]), tasks);
  group(made, "Identity", IDENTITY, tasks);
  return made;
}

function group(made, name, rows, tasks) {
  const body = made.createTBody();
  const title = heading("rowgroup", name);
  title.colSpan = tasks.length + 1;
  body.insertRow().append(title);
  for (const [label, cell] of rows) {
    const values = tasks.map((task) => String(cell(task)));
    if (values.every((value) => value === dash)) continue;
    const row = body.insertRow();
    row.append(heading("row", label));
    for (const value of values) row.insertCell().textContent = value;
  }
}

function heading(scope, text) {
  const cell = document.createElement("th");
  cell.scope = scope;
  cell.textContent = text;
  return cell;
}

/** What stands on a map, and what it does to the drone. */
function legend(kinds) {
  const part = document.createElement("div");
  part.className = "legend";
  const title = document.createElement("h3");
  title.textContent = "Legend";
  const list = document.createElement("dl");
  for (const kind of kinds) {
    const entry = document.createElement("div");
    const term = document.createElement("dt");
    const sign = document.createElement("span");
    sign.setAttribute("aria-hidden", "true");
    sign.textContent = kind.emoji;
    term.append(sign, ` ${kind.name}`);
    const effect = document.createElement("dd");
    effect.textContent = kind.effect;
    entry.append(term, effect);
    list.append(entry);
  }
  part.append(title, list);
  return part;
}
