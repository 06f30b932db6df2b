// The graph and the playback controls below the map.
import { el, icon, onPress, setText } from "./dom.js";
import { title } from "./format.js";
import { SPEEDS } from "./stage.js";
import { mountTimeline } from "./timeline.js";

const PLAY = ["!M7 4.500v15l13-7.500z"];
const PAUSE = ["!M7 5h3.500v14H7z", "!M13.500 5H17v14h-3.500z"];

/** @param {HTMLElement} root @param {Context} context @param {Race} race */
export function mountControls(root, context, race, acts) {
  const { stage } = context;
  const { clock } = stage;
  root.append(document.getElementById("playback").content);
  const [toggle, first, back, forward, last, undo, fork, reset] = root.querySelectorAll("button");
  onPress(root, { start: acts.toggle, first: acts.first, back: acts.back, step: acts.forward, last: acts.last });
  onPress(root, { undo: acts.undo, fork: acts.fork, reset: acts.reset });
  const speed = root.querySelector("select");
  speed.append(...SPEEDS.map((steps) => el("option", { value: String(steps), text: `${steps} steps/s` })));
  speed.addEventListener("change", () => clock.setSpeed(Number(speed.value)));
  const where = root.querySelector("p");
  mountTimeline(root.querySelector("div"), context);

  function update() {
    const { track } = stage;
    const [word, playing] = acts.word();
    // Replacing the children of a pressed button would cancel the click.
    if (toggle.textContent !== word) toggle.replaceChildren(icon(...(playing ? PAUSE : PLAY)), el("span", { text: word }));
    toggle.title = `${word} (${race.byHand ? "Enter" : "Space"})`;
    toggle.disabled = !track;
    toggle.hidden = speed.hidden = race.byHand && !stage.goesOn;
    first.disabled = back.disabled = clock.cursor === 0;
    last.disabled = clock.following;
    forward.disabled = !track || playing || (!stage.goesOn && clock.cursor === clock.end());
    undo.hidden = race.human < 0 || !race.shown;
    undo.disabled = race.begun === null;
    fork.hidden = !track || race.atHand;
    fork.disabled = !track || track.frameAt(clock.cursor).done;
    reset.disabled = !track;
    speed.value = String(clock.speed);
    setText(where, track ? sentence(track, clock.cursor, stage) : "");
    where.classList.toggle("behind", !clock.following);
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
