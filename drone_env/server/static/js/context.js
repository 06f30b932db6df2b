// The shared state of the page.
import { ApiError } from "./api.js";
import { Emitter } from "./base.js";
import { Camera } from "./camera.js";
import { LAYERS } from "./layers.js";
import { Stage } from "./stage.js";

/**
 * @typedef {Object} Context
 * @property {import("./router.js").Router} router The address of the page.
 * @property {ReturnType<import("./api.js").createApi>} api HTTP calls.
 * @property {import("./live.js").Live} live The socket.
 * @property {Answer<"TaskInfo">[]} tasks @property {Map<string, Answer<"TaskInfo">[]>} families The tasks by family.
 * @property {Answer<"PilotInfo">[]} pilots @property {number} most The maximum number of pilots of a flight.
 * @property {Answer<"KindInfo">[]} kinds
 * @property {Stage} stage The map, the flights and the moment of Fly.
 * @property {(track: import("./track.js").Track) => boolean} byHand Whether a visitor flies it.
 * @property {(track: import("./track.js").Track) => boolean} secret Whether values are hidden: a visitor flies without them.
 * @property {Camera} camera @property {(id: string) => boolean} shows Whether a layer is shown.
 * @property {(id: string, shown: boolean) => void} showLayer
 * @property {string} view "fly", "compare", "learn", "api" or "draw".
 * @property {(name: string|null) => Promise} meet Loads the task of a drawn map, which `/tasks` does not list.
 * @property {(event: string, f: Function) => () => void} on
 * @property {(event: string, ...args: any[]) => void} emit
 *
 * Events, sent after a change: "view" (name), "theme" (name), "layers", "camera", "task" (new task).
 */

/** @returns {Context} */
export function createContext(parts) {
  const families = new Map();
  for (const task of parts.tasks) families.set(task.family, [...(families.get(task.family) ?? []), task]);
  const chosen = new Map();
  const context = Object.assign(new Emitter(), parts, {
    families,
    stage: new Stage(),
    camera: new Camera(),
    view: "fly",
    byHand: () => false,
    secret: () => false,
    shows(id) {
      const { name, on } = LAYERS.find((layer) => layer.id === id);
      return chosen.get(id) ?? (!name || (on?.(context) ?? false));
    },
    showLayer(id, shown) {
      chosen.set(id, shown);
      context.emit("layers");
    },
  });
  context.meet = (name) => meet(context, name);
  return context;
}

/** Adds a task of `GET /tasks/{task_name}`. @param {import("./context.js").Context} context */
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
    // If the map is unknown, the start request reports it.
    if (!(error instanceof ApiError && error.status === 404)) throw error;
  }
}
