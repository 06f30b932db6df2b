// What all parts of the page share.
import { Camera } from "./camera.js";
import { Emitter } from "./emitter.js";
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
  context.meet = async (name) => name?.startsWith("drawn_") && (await import("./drawn.js")).meet(context, name);
  return context;
}
