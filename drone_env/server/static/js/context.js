// What all parts of the page share.
import { Emitter } from "./emitter.js";
import { Player } from "./player.js";

/**
 * @typedef {Object} Context
 * @property {import("./router.js").Router} router The address, which is what the page shows.
 * @property {ReturnType<import("./api.js").createApi>} api HTTP calls.
 * @property {import("./live.js").Live} live The socket.
 * @property {Object[]} tasks As `GET /tasks` tells them.
 * @property {Map<string, Object[]>} families The same by family.
 * @property {Object[]} rewardProfiles Likewise.
 * @property {Object[]} pilots As `GET /pilots` tells them.
 * @property {Object[]} kinds As `GET /kinds` tells them.
 * @property {Player[]} players The flights of Watch and Race, as many as may race; those without a flight are empty.
 * @property {Player} player The first of them.
 * @property {string} view "watch", "race", "replay", "history", "learn" or "api".
 * @property {(event: string, f: Function) => () => void} on
 * @property {(event: string, ...args: any[]) => void} emit
 *
 * Events: "view" (name) another view is shown; "theme" (name) the colours have changed; "missions" (players) flights
 * have been started; "maps" (CityMaps) they are drawn; "ended" (index, EpisodeSummary) one has ended and is stored;
 * "selected" (index) one of the maps was chosen.
 * Wishes: "open" (view) another view; "replay" (episode id) the replay of a stored episode; "select" (index) a map;
 * "explain" (player) what each move of an ended flight gave away; "arrows" whether the values of the actions stand on
 * the maps may have changed.
 */

/** @returns {Context} */
export function createContext(parts) {
  const players = Array.from({ length: parts.most }, () => new Player());
  const families = new Map();
  for (const task of parts.tasks) families.set(task.family, [...(families.get(task.family) ?? []), task]);
  return Object.assign(new Emitter(), parts, { families, players, player: players[0], view: "watch" });
}
