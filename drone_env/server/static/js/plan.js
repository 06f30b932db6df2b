// The flight plan on the left: which task, which map, who flies.
import { copyLink, el, icon, setText, toast } from "./dom.js";
import { title } from "./format.js";
import { linkOf } from "./router.js";

/** @param {HTMLElement} root @param {import("./context.js").Context} context @param {import("./fleet.js").Fleet} fleet */
export function mountPlan(root, context, fleet) {
  const tasks = el("fieldset.choice", el("legend", { text: "Task" }));
  const pilots = el("fieldset.choice", el("legend", { text: "Pilot" }));
  const problem = el("p.problem", { role: "alert", hidden: true });
  const { form, seed } = mapForm(fleet);
  const profile = el("select", { id: "profile", on: { change: () => fleet.start({ profile: profile.value }) } });
  for (const { id, summary } of context.rewardProfiles)
    profile.append(el("option", { value: id, text: title(id), title: summary }));
  const rewards = el("div.field", el("label.eyebrow", { for: "profile", text: "Rewards" }), profile);
  root.append(tasks, pilots, form, rewards);
  // Above the maps: on narrow screens the plan is far below.
  document.getElementById("deck").prepend(problem);

  drawTasks();
  drawPilots();
  update();

  fleet.on("setup", update);
  fleet.on("refused", (detail) => {
    const press = () => fleet.start(fleet.asks({ pilots: [] }, 1));
    const another = el("button.button.small", { text: "Fly another map", press });
    problem.replaceChildren(detail, " ", ...(fleet.active.length ? [] : [another]));
    problem.hidden = false;
  });
  context.on("missions", () => {
    problem.hidden = true;
  });
  context.on("view", () => {
    drawPilots();
    update();
  });

  function drawTasks() {
    for (const [family, members] of context.families) {
      const name = title(family);
      tasks.append(
        el(
          "div.task-row",
          { role: "group", "aria-label": name },
          el("span.task-group", { text: name, "aria-hidden": "true" }),
          ...members.map((task) => taskOption(task, name)),
        ),
      );
    }
    tasks.append(el("p.note.task-note", { id: "task-note" }));
  }

  function taskOption(task, family) {
    const label = title(task.short_name).replace(`${family} `, "");
    const input = el("input", {
      type: "radio",
      name: "task",
      value: task.short_name,
      "aria-label": title(task.short_name),
      "aria-describedby": "task-note",
      on: { change: () => chooseTask(task) },
    });
    return el("label.task-option", input, el("span", { text: label }));
  }

  /** Pilots that cannot fly the task give way, and the page says so. */
  function chooseTask(task) {
    const able = fleet.setup.pilots.filter((id) => fleet.flies(id, task));
    const wanted = context.view === "race" ? 2 : 1;
    for (const id of fleet.able(task)) if (able.length < wanted && !able.includes(id)) able.push(id);
    const left = fleet.setup.pilots.filter((id) => !able.includes(id)).map((id) => fleet.pilot(id).name);
    if (left.length) toast(`${left.join(" and ")} cannot fly ${title(task.short_name)}.`);
    fleet.start({ task: task.short_name, seed: null, pilots: able });
  }

  function drawPilots() {
    const race = context.view === "race";
    pilots.querySelectorAll(".pilot").forEach((node) => node.remove());
    setText(pilots.querySelector("legend"), race ? `Pilots, up to ${context.most}` : "Pilot");
    for (const pilot of context.pilots) {
      const input = el("input", {
        type: race ? "checkbox" : "radio",
        name: "pilot",
        value: pilot.id,
        "aria-label": pilot.name,
        "aria-describedby": `about-${pilot.id}`,
        on: { change: () => choosePilot(pilot.id, race) },
      });
      pilots.append(
        el(
          "label.pilot",
          input,
          el("span.pilot-name", { text: pilot.name }),
          el("span.pilot-note", { id: `about-${pilot.id}`, text: pilot.summary }),
        ),
      );
    }
  }

  function choosePilot(id, race) {
    const { setup } = fleet;
    // The next arrow is to fly, not to choose another pilot.
    if (!fleet.pilot(id).automatic) document.activeElement.blur();
    if (!race) {
      fleet.start({ pilots: [id] });
      return;
    }
    const chosen = setup.pilots.includes(id) ? setup.pilots.filter((other) => other !== id) : [...setup.pilots, id];
    fleet.start({ pilots: chosen });
  }

  function update() {
    const { setup } = fleet;
    const task = fleet.task();
    for (const input of tasks.querySelectorAll("input")) input.checked = input.value === task?.short_name;
    setText(tasks.querySelector(".task-note"), task ? taskNote(task) : "");
    for (const input of pilots.querySelectorAll("input")) {
      input.checked = setup.pilots.includes(input.value);
      const able = fleet.flies(input.value);
      const last = context.view === "race" && input.checked && setup.pilots.length <= 2;
      const full = context.view === "race" && !input.checked && setup.pilots.length >= context.most;
      input.disabled = !able || last || full;
      input.closest(".pilot").classList.toggle("unable", !able);
      setText(
        input.closest(".pilot").querySelector(".pilot-note"),
        able ? fleet.pilot(input.value).summary : "has no network here",
      );
    }
    if (document.activeElement !== seed) seed.value = setup.seed ?? "";
    profile.value = setup.profile ?? context.player.mission?.reward_profile ?? profile.value;
  }
}

function taskNote(task) {
  const parcels = task.deliveries === 1 ? "one parcel" : `${task.deliveries} parcels`;
  const time = `${task.max_steps} steps`;
  const charge = task.pads ? `, a battery of ${task.battery_capacity} that pads recharge` : "";
  return `Deliver ${parcels} on ${task.width} × ${task.height} cells in ${time}${charge}.`;
}

function mapForm(fleet) {
  const seed = el("input.input", {
    id: "seed",
    type: "number",
    min: "0",
    max: String(Number.MAX_SAFE_INTEGER),
    step: "1",
    inputmode: "numeric",
    autocomplete: "off",
  });
  const open = () => {
    if (seed.validity.badInput || seed.value !== "") {
      if (seed.reportValidity()) fleet.start({ seed: Number(seed.value) });
    } else seed.value = fleet.setup.seed ?? "";
  };
  seed.addEventListener("change", open);
  const fresh = el("button.button.small", {
    id: "new-map",
    press: () => fleet.start({ seed: null }),
    title: "Another map (N)",
    text: "New map",
  });
  const copy = el(
    "button.button.small",
    {
      id: "copy-link",
      "aria-label": "Copy link to this flight",
      title: "Copy link to this flight",
      press: () => copyLink(linkOf(fleet.setup)),
    },
    icon(
      "M10 14a4 4 0 0 0 6 .4l2.6-2.6a4 4 0 0 0-5.7-5.7L11.500 7.500M14 10a4 4 0 0 0-6-.4l-2.600 2.600a4 4 0 0 0 5.700 5.700l1.400-1.400",
    ),
    el("span", { text: "Copy link" }),
  );
  const form = el(
    "form.map-form",
    {
      on: {
        submit: (event) => {
          event.preventDefault();
          open();
        },
      },
    },
    el("label.eyebrow", { for: "seed", text: "Map" }),
    seed,
    el("div.row", fresh, copy),
  );
  return { form, seed };
}
