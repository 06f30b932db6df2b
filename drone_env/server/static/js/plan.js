// The flight plan: task, map and pilots.
import { el, leaveFocus, setText } from "./dom.js";
import { counted, title, variants } from "./format.js";
import { copyLink } from "./router.js";

/** The line above the map, which opens the choices. @returns {HTMLElement} The choices. */
export function mountPlan(root, context, race, acts) {
  const { stage } = context;
  const heading = el("summary.plan-head");
  const tasks = el("fieldset.choice", el("legend", { text: "Task" }));
  const pilots = el("fieldset.choice", el("legend", { text: `Pilots, up to ${context.most}` }));
  const { form, label, seed, fresh, edit, copy, typing } = mapForm(context, race, acts, () => update());
  const choices = el("div.plan-choices", tasks, pilots, form);
  const details = el("details.plan-details", heading, choices);
  root.append(details, el("div.plan-ways", fresh, copy));
  const ask = document.getElementById("ask");
  const close = () => (details.open = false);
  const inside = (target) => target instanceof Node && [details, ask].some((one) => one.contains(target));
  document.addEventListener("pointerdown", ({ target }) => inside(target) || close());
  document.addEventListener("keydown", ({ key, target }) => {
    if (key !== "Escape" || !details.open) return;
    if (inside(target)) heading.focus();
    close();
  });

  const note = el("p.note.task-note", { id: "task-note" });
  tasks.append(note);
  function list(family, members) {
    const name = title(family);
    const group = el("span.task-group", { text: name, "aria-hidden": "true" });
    const options = members.map((task) => taskOption(task, name));
    note.before(el("div.task-row", { role: "group", "aria-label": name }, group, ...options));
  }
  for (const [family, members] of context.families) list(family, members);
  context.on("task", (task) => list(task.family, [task]));
  const rows = context.pilots.map(pilotRow);
  pilots.append(...rows.map(({ row }) => row));

  function taskOption(task, family) {
    const input = el("input", {
      type: "radio",
      name: "task",
      value: task.short_name,
      "aria-label": title(task.short_name),
      "aria-describedby": "task-note",
      on: { change: () => chooseTask(task) },
    });
    return el("label.task-option", input, el("span", { text: title(task.short_name).replace(`${family} `, "") }));
  }

  /** The name flies this pilot alone; the box adds it to the others. */
  function pilotRow(pilot) {
    const name = el("button.pilot-name", {
      text: pilot.name,
      "aria-describedby": `about-${pilot.id}`,
      press() {
        if (!pilot.automatic) {
          // The next arrow key is for the drone, not for this button.
          leaveFocus();
          close();
        }
        choosePilots([pilot.id]);
      },
    });
    const box = el("input", {
      type: "checkbox",
      name: "pilot",
      value: pilot.id,
      "aria-label": `Add ${pilot.name}`,
      title: "Add to the flight",
      on: { change: () => choosePilots(box.checked ? [...chosen(), pilot.id] : chosen().filter((id) => id !== pilot.id)) },
    });
    const about = el("span.pilot-note", { id: `about-${pilot.id}`, text: pilot.summary });
    const row = el("div.pilot", { style: { "--lane": `var(--pilot-${pilot.colour})` } }, name, box, about);
    return { pilot, row, name, box, about };
  }

  const isPast = () => Boolean(stage.world) && !race.shown;
  const chosen = () => (isPast() ? [] : race.setup.pilots);

  const choosePilots = (pilots) => acts.start({ pilots }).finally(update);

  /** The same pilots; the rows of those that cannot fly the task show the reason. */
  const chooseTask = (task) => acts.start({ task: task.short_name, seed: null, pilots: [] }).finally(update);

  function update() {
    const { setup } = race;
    const past = isPast();
    const task = past ? stage.world.task : race.task;
    const names = race.starting ? setup.pilots.map((id) => context.pilot(id).name) : stage.tracks.map(({ name }) => name);
    const map = (past ? stage.world.seed : setup.seed) ?? "";
    fresh.hidden = label.hidden = seed.hidden = !variants(task);
    const number = !fresh.hidden && map !== "" && `map ${map}`;
    setText(heading, [task ? title(task.short_name) : setup.task, number, names.join(", ")].filter(Boolean).join(" · "));
    for (const input of tasks.querySelectorAll("input")) input.checked = input.value === task?.short_name;
    setText(note, task ? taskNote(task) : "");
    edit.href = task ? `?view=draw&task=${task.short_name}&seed=${map}` : "?view=draw";
    copy.disabled = !stage.track || (past && !stage.track.episode);
    pilots.dataset.many = String(setup.pilots.length > 1);
    for (const { pilot, row, name, box, about } of rows) {
      const able = race.flies(pilot.id, task);
      box.checked = !past && setup.pilots.includes(pilot.id);
      const last = box.checked && setup.pilots.length === 1;
      name.disabled = !able;
      name.setAttribute("aria-pressed", String(box.checked));
      box.disabled = !able || last || (!box.checked && setup.pilots.length >= context.most);
      row.classList.toggle("unable", !able);
      setText(about, able ? pilot.summary : "no network for this task");
    }
    if (!typing()) seed.value = map;
  }

  race.on("setup", update);
  stage.on("load", update);
  update();
  return choices;
}

function taskNote(task) {
  const charge = task.pads ? `, a battery of ${task.battery_capacity} that pads recharge` : "";
  return `Deliver ${counted(task.deliveries, "parcel")} on ${task.width} × ${task.height} cells in ${task.max_steps} steps${charge}.`;
}

function mapForm({ router, stage }, race, acts, update) {
  let typed = false;
  const seed = el("input.input", {
    id: "seed",
    type: "number",
    min: "0",
    max: String(Number.MAX_SAFE_INTEGER),
    step: "1",
    inputmode: "numeric",
    autocomplete: "off",
    on: { input: () => (typed = true), blur: () => (typed = false), change: open },
  });
  function open() {
    typed = false;
    if (!seed.validity.badInput && seed.value === "") seed.value = stage.world?.seed ?? "";
    else if (seed.reportValidity() && Number(seed.value) !== (race.shown ? race.setup : stage.world)?.seed)
      acts.start({ seed: Number(seed.value) }).finally(update);
  }
  const fresh = el("button.button.small", { id: "new-map", press: acts.newMap, title: "Another map (N)", text: "New map" });
  const copy = el("button.button.small", {
    id: "copy-link",
    "aria-label": "Copy link to this moment",
    title: "Copy link to this moment",
    text: "Copy link",
    press: () => copyLink(router.address),
  });
  const edit = el("a.button.small", { id: "edit-map", text: "Edit this map" });
  // Enter triggers the change event of the number, which opens the map.
  const submit = (event) => event.preventDefault();
  const label = el("label.eyebrow", { for: "seed", text: "Map" });
  const form = el("form.map-form", { on: { submit } }, label, seed, edit);
  return { form, label, seed, fresh, edit, copy, typing: () => typed };
}
