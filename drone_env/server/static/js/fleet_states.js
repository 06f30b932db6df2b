// The states of the live flights and what leads from one to another.

/**
 * idle: nothing is asked of the server. playing: it flies the pilots. starting: a start waits for its answer, or for the
 * connection. launching: likewise, and then the pilots fly. interrupted: the connection is lost while they fly.
 * attaching: a new connection asks for the same flights. returning: likewise, and then the pilots fly on.
 *
 * @typedef {"idle"|"playing"|"starting"|"launching"|"interrupted"|"attaching"|"returning"} State
 * @typedef {"start"|"launch"|"pause"|"rest"|"attach"|"lost"|"flights"|"refused"|"plays"|"pauses"} Cause
 */
/** @type {Partial<Record<Cause, State>>} */
const START = { start: "starting", launch: "launching" };
/** @type {Partial<Record<Cause, State>>} */
const ANSWER = { flights: "idle", refused: "idle" };
/** The next state after each cause; a cause that is not listed changes nothing. @type {Record<State, Partial<Record<Cause, State>>>} */
export const NEXT = {
  idle: { ...START, attach: "attaching", plays: "playing", lost: "idle" },
  playing: { ...START, plays: "playing", pauses: "idle", flights: "idle", lost: "interrupted" },
  starting: { ...START, ...ANSWER, rest: "idle" },
  launching: { ...START, ...ANSWER, rest: "idle", pause: "starting" },
  interrupted: { pause: "idle", attach: "returning" },
  attaching: { ...START, ...ANSWER },
  returning: { ...START, ...ANSWER, pause: "attaching" },
};
