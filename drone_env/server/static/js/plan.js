// The flight plan: the tasks above the map, and the line that opens the choice of pilots and map.
import { el, keepFocus, leaveFocus, onPress, setText } from "./dom.js";
import { title, variants } from "./format.js";
import { specifications } from "./learn.js";
import { copyLink } from "./router.js";

/** The tasks, and the line above the map, which opens the choices. @param {HTMLElement} root @returns {Element} The choices. */
export function mountPlan(root, context, race, acts) {
  const { router, stage } = context;
  root.append(document.getElementById("plan").content);
  const details = root.querySelector("details");
  const heading = root.querySelector("summary");
  const pilots = root.querySelector("fieldset");
  const label = root.querySelector("label");
  const seed = root.querySelector("input");
  const edit = root.querySelector("a");
  const [fresh, copy] = root.querySelectorAll("button");
  pilots.querySelector("legend").textContent = `Pilots, up to ${context.most}`;
  const tasks = el("nav.tasks", { "aria-label": "Tasks" });
  const drawTasks = mountTasks(tasks, context, acts);
  root.before(tasks);
  const ask = document.getElementById("ask");
  const close = () => (details.open = false);
  const inside = (target) => target instanceof Node && [details, ask].some((one) => one.contains(target));
  document.addEventListener("pointerdown", ({ target }) => inside(target) || close());
  document.addEventListener("keydown", ({ key, target }) => {
    if (key !== "Escape" || !details.open) return;
    if (inside(target)) heading.focus();
    close();
  });
  onPress(root, { "new-map": acts.newMap, "copy-link": () => copyLink(router.address) });
  seed.addEventListener("blur", update);
  seed.addEventListener("change", openMap);
  const rows = context.pilots.map(pilotRow);
  pilots.append(...rows.map(({ row }) => row));

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
    return { pilot, row, name, box };
  }

  /** Whether the stage shows a flight of the store or of a file. */
  const isHistory = () => Boolean(stage.world) && !race.shown;
  const chosen = () => (isHistory() ? [] : race.setup.pilots);

  const choosePilots = (pilots) => acts.start({ pilots }).finally(update);

  function openMap() {
    if (!seed.reportValidity()) return;
    const { value } = seed;
    // From now on the field shows the map that is flown.
    seed.blur();
    if (value) acts.start({ seed: Number(value) }).finally(update);
  }

  function update() {
    const { setup } = race;
    const history = isHistory();
    const task = history ? stage.world.task : race.task;
    const names = race.starting ? setup.pilots.map((id) => context.pilot(id).name) : stage.tracks.map(({ name }) => name);
    const map = (history ? stage.world.seed : setup.seed) ?? "";
    drawTasks(task, map);
    fresh.hidden = label.hidden = seed.hidden = !variants(task);
    const number = !fresh.hidden && map !== "" && `map ${map}`;
    const flown = [task ? title(task.short_name) : setup.task, number, names.join(", ")].filter(Boolean).join(" · ");
    setText(heading, flown);
    if (context.view === "fly") document.title = `${flown} · Drone Delivery`;
    edit.href = task ? `?view=draw&task=${task.short_name}&seed=${map}` : "?view=draw";
    copy.disabled = !stage.track || (history && !stage.track.episode);
    pilots.dataset.many = String(setup.pilots.length > 1);
    for (const { pilot, row, name, box } of rows) {
      row.hidden = !race.flies(pilot.id, task);
      box.checked = !history && setup.pilots.includes(pilot.id);
      name.ariaPressed = String(box.checked);
      // The last one stays.
      box.disabled = setup.pilots.length === (box.checked ? 1 : context.most);
    }
    if (document.activeElement !== seed) seed.value = map;
  }

  race.on("setup", update);
  stage.on("load", update);
  context.on("view", update);
  update();
  return root.querySelector(".plan-choices");
}

/**
 * All standard tasks, all of the family that is flown, the first of each other one, and the map of the day; their numbers.
 * @param {HTMLElement} root @param {Context} context @returns {(task: Answer<"TaskInfo">, map: number|string) => void} Draws them.
 */
function mountTasks(root, context, acts) {
  const { task: daily, seed } = document.getElementById("today").dataset;
  const me = context.pilots.find(({ automatic }) => !automatic);
  const list = el("span");
  const numbers = el("div.numbers-of-tasks", { id: "specifications", popover: "auto", on: { beforetoggle: open } });
  const button = el("button.task", { text: "Specifications", popovertarget: numbers.id });
  root.append(list, button, numbers);
  let [family, drawn] = ["standard", ""];

  function open() {
    const close = el("button.button.small", { text: "Close", popovertarget: numbers.id });
    numbers.replaceChildren(close, specifications(context, family));
  }

  const option = (text, flown, change) =>
    el("button.task", { text, "aria-pressed": String(flown), data: { key: text }, press: () => acts.start(change) });

  return (task, map) => {
    const isDaily = task?.short_name === daily && String(map) === seed;
    const now = `${task?.id} ${isDaily} ${context.tasks.length}`;
    if (now === drawn) return;
    [family, drawn] = [task?.family ?? family, now];
    const groups = [...context.families].map(([name, all], i) => {
      const whole = i === 0 || name === family;
      const options = (whole ? all : all.slice(0, 1)).map((one) => {
        const text = title(whole ? one.short_name : name);
        return option(text, one === task && !isDaily, { task: one.short_name, seed: null, pilots: [] });
      });
      return el("span", { role: "group", "aria-label": title(name) }, ...options);
    });
    const today = { task: daily, seed: Number(seed), pilots: [me.id] };
    keepFocus(list, () => list.replaceChildren(...groups, option("Map of the day", isDaily, today)));
    /** @type {HTMLElement|null} */
    const flown = list.querySelector("[aria-pressed=true]");
    // In a narrow window, the tasks before it scroll out of sight; the button stays above the last ones.
    if (flown) root.scrollLeft = flown.offsetLeft + flown.offsetWidth + button.offsetWidth - root.clientWidth;
  };
}
