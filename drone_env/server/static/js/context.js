// What all parts of the page share.
import { Player } from "./player.js";

const RACERS = 4;

/**
 * @typedef {Object} Context
 * @property {ReturnType<import("./api.js").createApi>} api HTTP calls.
 * @property {import("./live.js").Live} live The socket.
 * @property {Object[]} tasks As `GET /tasks` tells them.
 * @property {Object[]} rewardProfiles Likewise.
 * @property {Object[]} pilots As `GET /pilots` tells them.
 * @property {Object[]} kinds As `GET /kinds` tells them.
 * @property {Player[]} players The flights of Watch and Race, four; those without a mission are empty.
 * @property {Player} player The first of them.
 * @property {string} view "watch", "race", "replay", "history", "specs" or "logs".
 * @property {(event: string, f: Function) => () => void} on
 * @property {(event: string, ...args: any[]) => void} emit
 *
 * Events: "view" (name) another view is shown; "theme" (name) the colours have changed; "missions" (players) missions
 * have been started; "maps" (CityMaps) they are drawn; "ended" (index, EpisodeSummary) one has ended and is stored;
 * "selected" (index) one of the maps was chosen.
 * Wishes: "open" (view) another view; "replay" (episode id) the replay of a stored episode; "select" (index) a map;
 * "explain" (player) what each move of an ended flight gave away; "arrows" (shown) the values of the actions on the maps.
 */

/** @returns {Context} */
export function createContext(parts) {
  const listeners = new Map();
  const players = Array.from({ length: RACERS }, () => new Player());
  return {
    ...parts,
    players,
    player: players[0],
    view: "watch",
    on(event, f) {
      if (!listeners.has(event)) listeners.set(event, new Set());
      listeners.get(event).add(f);
      return () => listeners.get(event).delete(f);
    },
    emit(event, ...args) {
      for (const f of listeners.get(event) ?? []) f(...args);
    },
  };
}
