// One animation frame for the whole page: whoever has something to draw asks for the next one.

const due = new Set();
let asked = false;

/** Calls `draw(now)` in the next animation frame, once, however often it is asked for. */
export function nextFrame(draw) {
  due.add(draw);
  if (asked) return;
  asked = true;
  requestAnimationFrame(run);
}

/** Takes the wish back. */
export function noFrame(draw) {
  due.delete(draw);
}

function run(now) {
  asked = false;
  const drawers = [...due];
  due.clear();
  for (const draw of drawers) draw(now);
}

const still = matchMedia("(prefers-reduced-motion: reduce)");

/** Whether the visitor asked for less motion. */
export const lessMotion = () => still.matches;
