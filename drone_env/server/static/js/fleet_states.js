// The states of the live flights and what leads from one to another.

/**
 * idle: nothing is asked of the server. playing: it flies the pilots. starting: a start waits for its answer, or for the
 * connection. launching: likewise, and then the pilots fly. interrupted: the connection is lost while they fly.
 * attaching: a new connection asks for the same flights. returning: likewise, and then the pilots fly on.
 */
/** @type {Partial<Record<FleetCause, FleetState>>} */
const START = { start: "starting", launch: "launching" };
/** @type {Partial<Record<FleetCause, FleetState>>} */
const ANSWER = { flights: "idle", refused: "idle" };
/** The next state after each cause; a cause that is not listed changes nothing. @type {Record<FleetState, Partial<Record<FleetCause, FleetState>>>} */
export const NEXT = {
  idle: { ...START, attach: "attaching", plays: "playing", lost: "idle" },
  playing: { ...START, plays: "playing", pauses: "idle", flights: "idle", lost: "interrupted" },
  starting: { ...START, ...ANSWER, rest: "idle" },
  launching: { ...START, ...ANSWER, rest: "idle", pause: "starting" },
  interrupted: { pause: "idle", attach: "returning" },
  attaching: { ...START, ...ANSWER },
  returning: { ...START, ...ANSWER, pause: "attaching" },
};
