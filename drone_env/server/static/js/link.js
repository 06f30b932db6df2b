// Links: `?task=hard&seed=7&pilot=pathqnet` is exactly one flight, `?pilots=pathqnet,greedy` a race on it.
import { toast } from "./dom.js";

/** @param {import("./context.js").Context} context @returns {import("./fleet.js").Setup} What the address of the page asks for; no pilots where it names none. */
export function setupFromLink({ tasks }) {
  const link = new URLSearchParams(location.search);
  const pilots = (link.get("pilots") ?? link.get("pilot") ?? "").split(",").filter(Boolean);
  const seed = link.get("seed");
  return {
    task: link.get("task") ?? tasks[0].short_name,
    // What is no number of a map goes to the server as it is: its answer says what is allowed.
    seed: !seed ? null : Number.isSafeInteger(Number(seed)) ? Number(seed) : seed,
    profile: link.get("profile"),
    pilots,
  };
}

/** The address at which the same flights open. @param {import("./fleet.js").Setup} setup */
export function linkOf({ task, seed, profile, pilots }) {
  const parts = [`task=${encodeURIComponent(task)}`];
  if (seed !== null) parts.push(`seed=${encodeURIComponent(seed)}`);
  parts.push(`${pilots.length > 1 ? "pilots" : "pilot"}=${pilots.map(encodeURIComponent).join(",")}`);
  if (profile !== null) parts.push(`profile=${encodeURIComponent(profile)}`);
  const url = new URL(document.baseURI);
  url.search = parts.join("&");
  url.hash = "";
  return url;
}

/** Puts the flights into the address bar. */
export function showLink(setup) {
  const url = linkOf(setup);
  url.hash = location.hash;
  history.replaceState(null, "", url);
}

/** Copies an address. */
export async function copyLink(url) {
  try {
    await navigator.clipboard.writeText(String(url));
    toast("Link copied.");
  } catch {
    // Without leave to write the clipboard, as in a frame of another site, the visitor copies it by hand.
    window.prompt("The link to this flight:", url);
  }
}
