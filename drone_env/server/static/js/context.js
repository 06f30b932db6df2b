// What all parts of the page share.
import { ApiError } from "./api.js";
import { Emitter } from "./base.js";
import { Camera } from "./camera.js";
import { LAYERS } from "./layers.js";
import { Stage } from "./stage.js";

/**
 * @typedef {Object} Context
 * @property {import("./router.js").Router} router The address, which is what the page shows.
 * @property {ReturnType<import("./api.js").createApi>} api HTTP calls.
 * @property {import("./live.js").Live} live The socket.
 * @property {Object[]} tasks As `GET /tasks` tells them.
 * @property {Map<string, Object[]>} families The same by family.
 * @property {Object[]} rewardProfiles Likewise.
 * @property {Object[]} pilots As `GET /pilots` tells them. @property {number} most How many may fly at once.
 * @property {Object[]} kinds As `GET /kinds` tells them.
 * @property {Stage} stage The map, the flights and the moment that are shown in Fly.
 * @property {Camera} camera @property {(id: string) => boolean} shows Whether a layer is shown.
 * @property {string} view "fly", "compare", "learn", "api" or "draw".
 * @property {(name: string|null) => Promise} meet Asks for the task of a drawn map, which `/tasks` does not list.
 * @property {(event: string, f: Function) => () => void} on
 * @property {(event: string, ...args: any[]) => void} emit
 *
 * Events: "view" (name) another view is shown; "theme" (name) the colours have changed; "layers" others are shown; "camera" the
 * map is seen from elsewhere; "task" (task) one more is known.
 */

/** @returns {Context} */
export function createContext(parts) {
  const families = new Map();
  for (const task of parts.tasks) families.set(task.family, [...(families.get(task.family) ?? []), task]);
  const layers = new Set(LAYERS.filter(({ name, on }) => on || !name).map(({ id }) => id));
  const context = Object.assign(new Emitter(), parts, {
    families,
    stage: new Stage(),
    camera: new Camera(),
    view: "fly",
    shows: (id) => layers.has(id),
    /** Shows a layer, or hides it. */
    showLayer(id, shown) {
      if (shown) layers.add(id);
      else layers.delete(id);
      context.emit("layers");
    },
  });
  context.meet = (name) => meet(context, name);
  return context;
}

/** One more task, as `GET /tasks/{task_name}` tells it. @param {import("./context.js").Context} context */
export function add(context, { task, pilots }) {
  const { families } = context;
  if (context.tasks.some(({ id }) => id === task.id)) return;
  context.tasks.push(task);
  families.set(task.family, [...(families.get(task.family) ?? []), task]);
  for (const pilot of context.pilots) if (pilots.includes(pilot.id)) pilot.tasks.push(task.id);
  context.emit("task", task);
}

/** Asks for the task of a drawn map by its name, unless it is known. */
async function meet(context, name) {
  if (!name?.startsWith("drawn_") || context.tasks.some(({ id }) => id === name)) return;
  try {
    add(context, await context.api.get(`tasks/${encodeURIComponent(name)}`));
  } catch (error) {
    // Of a map that is not kept here the server says so where it is to be flown.
    if (!(error instanceof ApiError && error.status === 404)) throw error;
  }
}
