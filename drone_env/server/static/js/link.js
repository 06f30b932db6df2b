// Links: `?task=hard&seed=7&pilot=pathqnet` is exactly one mission, `?pilots=pathqnet,greedy` a race on it.
import { DEFAULT_PROFILE, FIRST_TASK } from "./fleet.js";

const FIRST_PILOT = "pathqnet";
const OWN_PILOT = "trained";

/** @returns {import("./fleet.js").Setup} What the address of the page asks for; no pilots where it names none. */
export function setupFromLink() {
  const link = new URLSearchParams(location.search);
  const pilots = (link.get("pilots") ?? link.get("pilot") ?? "").split(",").filter(Boolean);
  const seed = link.get("seed");
  return {
    task: link.get("task") ?? FIRST_TASK,
    // What is no number of a map goes to the server as it is: its answer says what is allowed.
    seed: !seed ? null : Number.isSafeInteger(Number(seed)) ? Number(seed) : seed,
    profile: link.get("profile") ?? DEFAULT_PROFILE,
    pilots,
  };
}

/** Who flies where nobody was named: the visitor's own network, if one was trained for the task. */
export function firstPilot(fleet) {
  const own = fleet.context.pilots.some(({ id }) => id === OWN_PILOT) && fleet.flies(OWN_PILOT);
  return own ? OWN_PILOT : FIRST_PILOT;
}

/** The address at which the same missions open. @param {import("./fleet.js").Setup} setup */
export function linkOf({ task, seed, profile, pilots }) {
  const parts = [`task=${encodeURIComponent(task)}`];
  if (seed !== null) parts.push(`seed=${encodeURIComponent(seed)}`);
  parts.push(`${pilots.length > 1 ? "pilots" : "pilot"}=${pilots.map(encodeURIComponent).join(",")}`);
  if (profile !== DEFAULT_PROFILE) parts.push(`profile=${encodeURIComponent(profile)}`);
  const url = new URL(document.baseURI);
  url.search = parts.join("&");
  url.hash = "";
  return url;
}

/** Puts the missions into the address bar. */
export function showLink(setup) {
  const url = linkOf(setup);
  url.hash = location.hash;
  history.replaceState(null, "", url);
}
