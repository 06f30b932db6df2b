// The playback controls, and the graph of the possible score by step, one line per flight, under a slider.
import { el, onPress, setText } from "./dom.js";
import { points, title } from "./format.js";
import { describe } from "./moves.js";

/** The minimum width of the graph in steps. */
const SHORTEST = 10;

/** @param {HTMLElement} root @param {Context} context @param {Race} race */
export function mountControls(root, context, race, acts) {
  const { stage } = context;
  const { clock } = stage;
  const [toggle, first, back, forward, last, undo, fork, reset] = root.querySelectorAll("button");
  onPress(root, { start: acts.toggle, first: acts.first, back: acts.back, step: acts.forward, last: acts.last });
  onPress(root, { undo: acts.undo, fork: acts.fork, reset: acts.reset });
  const speed = root.querySelector("select");
  speed.addEventListener("change", () => (clock.speed = Number(speed.value)));
  const where = root.querySelector("p");
  const slider = root.querySelector("input");
  slider.addEventListener("input", () => clock.goTo(Number(slider.value)));

  function update() {
    const { track } = stage;
    const word = clock.playing ? "Pause" : !stage.goesOn ? "Replay" : clock.cursor > 0 ? "Resume" : "Start";
    setText(toggle.lastElementChild, word);
    toggle.title = `${word} (${race.byHand ? "Enter" : "Space"})`;
    toggle.dataset.playing = String(clock.playing);
    toggle.disabled = !track;
    toggle.hidden = speed.hidden = race.byHand && !stage.goesOn;
    first.disabled = back.disabled = clock.cursor === 0;
    last.disabled = clock.following;
    forward.disabled = !track || clock.playing || (!stage.goesOn && clock.cursor === clock.end());
    undo.hidden = race.human < 0 || !race.shown;
    undo.disabled = race.begun === null;
    fork.hidden = !track || race.atHand;
    fork.disabled = !track || track.frameAt(clock.cursor).done;
    reset.disabled = !track;
    setText(where, track ? sentence(track, clock.cursor, stage) : "");
    where.classList.toggle("behind", !clock.following);
    if (track) draw(track);
  }

  function draw(track) {
    const newest = clock.end();
    // A live flight has some free steps on the right.
    const wide = Math.max(SHORTEST, newest, stage.over ? 0 : Math.min(stage.world.max_steps, newest + 5));
    slider.max = String(newest);
    slider.value = String(clock.cursor);
    slider.disabled = newest === 0;
    slider.setAttribute("aria-valuetext", `Step ${clock.cursor}: ${describe(track, clock.cursor)}`);
    slider.style.width = `${(newest / wide) * 100}%`;
    drawGraph(root.querySelector(".timeline"), stage, wide);
  }

  stage.on("change", update);
  for (const event of ["setup", "begun"]) race.on(event, update);
}

/** The present step: `Step 12 of 35 · LEFT · Delivery`. */
function sentence(track, step, { world }) {
  const { step: at, action, event } = track.frameAt(step);
  const happened = action && !["step", "wait"].includes(event) ? title(event) : null;
  return [`Step ${at} of ${track.done ? track.steps : world.max_steps}`, action, happened].filter(Boolean).join(" · ");
}

/** Draws in units of steps and scores; the selected flight, its deliveries and its bad moves are in front. */
function drawGraph(root, { track, tracks, clock }, wide) {
  const [graph, above, below] = root.children;
  const all = tracks.flatMap(({ frames }) => frames.map(({ value, score }) => value ?? score));
  const high = Math.min(1, Math.ceil(Math.max(...all) * 10) / 10);
  const low = Math.max(0, Math.min(high - 0.2, Math.floor(Math.min(...all) * 10) / 10));
  const path = (d, data, colour) => el("svg:path", { d, data, style: { "--lane": `var(${colour})` } });
  const dots = (data, steps, heightOf) => path(steps.map((step) => `M${step} ${heightOf(step)}h0`).join(""), data);
  const delivered = track.frames.filter(({ event }) => event === "delivery").map(({ step }) => step);
  const { moves = [] } = track.annotation ?? {};
  const marks = ["inaccuracy", "mistake", "blunder"].map((label) => {
    const steps = moves.filter((move) => move.label === label).map(({ step }) => step);
    return dots({ label }, steps, (step) => -(track.frames[step].value ?? track.frames[step].score));
  });
  graph.setAttribute("viewBox", `0 ${-high} ${wide} ${high - low}`);
  graph.replaceChildren(
    ...tracks.filter((one) => one !== track).map((one) => path(lineOf(one), { line: "other" }, one.colour)),
    path(lineOf(track), { line: "selected" }, track.colour),
    dots({ line: "delivery" }, delivered, () => -low),
    ...marks,
    path(`M${clock.cursor} ${-high}V${-low}`, { line: "now" }),
  );
  const known = tracks.some(({ frames }) => frames.some(({ value }) => value !== null));
  setText(above, known ? `${points(high, 0)} still possible` : "");
  setText(below, known ? points(low, 0) : "");
}

/** The possible score, unless it is hidden. A move loses its points at once. */
function lineOf({ frames }) {
  const known = frames.filter(({ value }) => value !== null);
  return known.map(({ step, value }, i) => (i ? `H${step}V${-value}` : `M${step} ${-value}`)).join("");
}
