// The list of a flight's moves with their marks, as beside a game of chess. Shared by Race and Replay.

/**
 * @param {HTMLElement} root Filled with the list.
 * @param {import("./player.js").Player} player Its `annotation` is listed; a click on a move seeks there.
 */
export function mountMoves(root, player) {}
