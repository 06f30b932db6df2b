// Maps that were drawn: tasks that `/tasks` does not list, each known to whoever has its name.
import { ApiError } from "./api.js";

/** One more task, as `GET /tasks/{task_name}` tells it. @param {import("./context.js").Context} context */
export function add(context, { task, pilots }) {
  const { families } = context;
  if (context.tasks.some(({ id }) => id === task.id)) return;
  context.tasks.push(task);
  families.set(task.family, [...(families.get(task.family) ?? []), task]);
  for (const pilot of context.pilots) if (pilots.includes(pilot.id)) pilot.tasks.push(task.id);
  context.emit("task", task);
}

/** Asks for a task by its name, unless it is known. */
export async function meet(context, name) {
  if (context.tasks.some(({ id }) => id === name)) return;
  try {
    add(context, await context.api.get(`tasks/${encodeURIComponent(name)}`));
  } catch (error) {
    // Of a map that is not kept here the server says so where it is to be flown.
    if (!(error instanceof ApiError && error.status === 404)) throw error;
  }
}
