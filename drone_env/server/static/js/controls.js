// The graph and the playback controls below the map.
import { el, icon, setText } from "./dom.js";
import { title } from "./format.js";
import { SPEEDS } from "./stage.js";
import { mountTimeline } from "./timeline.js";

const PLAY = ["!M7 4.500v15l13-7.500z"];
const PAUSE = ["!M7 5h3.500v14H7z", "!M13.500 5H17v14h-3.500z"];

/** @param {HTMLElement} root @param {Context} context @param {Race} race */
export function mountControls(root, context, race, acts) {
  const { stage } = context;
  const { clock } = stage;
  const button = (id, label, key, drawing, press) =>
    el("button.icon-button", { id, "aria-label": label, title: `${label} (${key})`, press }, icon(...drawing));
  const toggle = el("button.button.primary", { id: "start", press: acts.toggle });
  const first = button("first", "First step", "Home", ["M18 6l-7 6 7 6", "M6.500 6v12"], acts.first);
  const back = button("back", "Step back", "←", ["M15 6l-7 6 7 6"], acts.back);
  const forward = button("step", "Step", "→ or .", ["M9 6l7 6-7 6"], acts.forward);
  const last = button("last", "Last step", "End", ["M6 6l7 6-7 6", "M17.500 6v12"], acts.last);
  const named = (id, text, title, press) => el("button.button", { id, text, title, press });
  const undo = named("undo", "Undo", "Take back the last move (U)", acts.undo);
  const reset = named("reset", "Reset", "Restart this map (R)", acts.reset);
  const fork = named("fork", "Try from here", "Fly on from this step yourself (F)", () => acts.fork());
  const speed = el(
    "select",
    { id: "speed", "aria-label": "Speed", on: { change: () => clock.setSpeed(Number(speed.value)) } },
    ...SPEEDS.map((steps) => el("option", { value: String(steps), text: `${steps} steps/s` })),
  );
  const where = el("p.where", { id: "step-counter" });
  const timeline = el("div");
  const buttons = el("div.transport", { role: "group", "aria-label": "Playback" }, first, back, forward, last);
  root.append(timeline, el("div.controls", toggle, buttons, speed, undo, fork, reset), where);
  mountTimeline(timeline, context);

  function update() {
    const { track } = stage;
    const [word, playing] = acts.word();
    // Replacing the children of a pressed button would cancel the click.
    if (toggle.textContent !== word) toggle.replaceChildren(icon(...(playing ? PAUSE : PLAY)), el("span", { text: word }));
    toggle.title = `${word} (${race.byHand ? "Enter" : "Space"})`;
    toggle.disabled = !track;
    toggle.hidden = speed.hidden = race.byHand && !race.automatic;
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
