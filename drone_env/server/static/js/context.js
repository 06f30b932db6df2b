// The shared state of the page.
import { ApiError } from "./api.js";
import { Emitter } from "./base.js";
import { Camera } from "./camera.js";
import { title } from "./format.js";
import { LAYERS } from "./layers.js";
import { Stage } from "./stage.js";

/** What the page knows of an agent that is none of its pilots. */
const UNKNOWN = { summary: "", automatic: true, tasks: [], colour: "other" };

/** @returns {Context} */
export function createContext(parts) {
  const families = new Map();
  for (const task of parts.tasks) families.set(task.family, [...(families.get(task.family) ?? []), task]);
  const chosen = new Map();
  const context = Object.assign(new Emitter(), parts, {
    families,
    stage: new Stage(),
    camera: new Camera(),
    names: Object.fromEntries(parts.kinds.map(({ id, name }) => [id, name])),
    view: "fly",
    pilot: (id) => parts.pilots.find((pilot) => pilot.id === id) ?? { ...UNKNOWN, id, name: id },
    task: (name) => parts.tasks.find((task) => [task.id, task.short_name, task.grader].includes(name)),
    shows(id) {
      const { name, on, when } = LAYERS.find((layer) => layer.id === id);
      return (when?.(context.stage) ?? true) && (chosen.get(id) ?? (!name || (on?.(context) ?? false)));
    },
    showLayer(id, shown) {
      chosen.set(id, shown);
      context.emit("layers");
    },
  });
  context.meet = (name) => meet(context, name);
  return context;
}

/** Adds a task of `GET /tasks/{task_name}`. @param {Context} context */
export function add(context, { task, pilots }) {
  const { families } = context;
  if (context.tasks.some(({ id }) => id === task.id)) return;
  context.tasks.push(task);
  families.set(task.family, [...(families.get(task.family) ?? []), task]);
  for (const pilot of context.pilots) if (pilots.includes(pilot.id)) pilot.tasks.push(task.id);
  context.emit("task", task);
}

async function meet(context, name) {
  if (!name?.startsWith("drawn_") || context.tasks.some(({ id }) => id === name)) return;
  try {
    add(context, await context.api.get(`tasks/${encodeURIComponent(name)}`));
  } catch (error) {
    if (!(error instanceof ApiError && error.status === 404)) throw error;
    throw new Error(`This server does not have ${title(name)}. Open its file in Draw.`);
  }
}
