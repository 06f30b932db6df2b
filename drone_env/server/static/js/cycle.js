// After a flight over a standard task, the next task starts by itself unless the visitor stays.
import { nextFrame, recall, remember } from "./base.js";
import { announce, el, leaveFocus, setText } from "./dom.js";
import { title } from "./format.js";
import { nextTask } from "./results.js";

/** Keys of the visitor's choices: "on" or "off" after flights of pilots, and after flights by hand. */
const PILOTS = "drone-env-cycle-pilots";
const PEOPLE = "drone-env-cycle-people";
const SECONDS = 5;

/** @param {HTMLElement} root @param {Context} context @param {Race} race */
export function mountCycle(root, context, race) {
  const { stage, router } = context;
  const tasks = context.families.get("standard") ?? [];
  const text = el("span.note");
  const button = el("button.button.small", { id: "stay", press: choose });
  root.append(text, button);
  let left = 0;
  let timer = 0;

  const byHand = () => race.human >= 0;
  const isOn = () => (byHand() ? recall(PEOPLE) === "on" : recall(PILOTS) !== "off");
  const next = () => nextTask(context.families, stage.world.task);
  /** Whether the flights on the stage have just been flown here, and the visitor looks at their end. */
  function isOver() {
    const { clock, over, world } = stage;
    const flown = race.shown && over && race.setup.fork === null && !race.tracks.some(({ brought }) => brought);
    return flown && tasks.includes(world.task) && !race.starting && !router.address.lesson && !clock.playing && clock.following;
  }

  function count(seconds) {
    clearTimeout(timer);
    left = seconds;
    if (left) timer = setTimeout(tick, 1000);
    draw();
  }

  function tick() {
    const shown = context.view === "fly" && !document.querySelector("dialog[open]");
    if (!isOver() || !shown) count(0);
    // A hidden page waits for its visitor.
    else if (left > 1 || document.hidden) count(document.hidden ? left : left - 1);
    else flyNext();
  }

  function flyNext() {
    const task = next();
    const pilots = race.setup.pilots.filter((id) => race.flies(id, task));
    if (byHand()) leaveFocus();
    count(0);
    race.start({ task: task.short_name, seed: null, pilots }, { play: !byHand() });
  }

  function choose() {
    const on = !isOn();
    remember(byHand() ? PEOPLE : PILOTS, on ? "on" : "off");
    count(on ? SECONDS : 0);
  }

  function draw() {
    root.hidden = !isOver() || (isOn() && !left);
    if (root.hidden) return;
    setText(text, left ? `Next: ${title(next().short_name)} in ${left} s ` : "");
    setText(button, isOn() ? "Stay" : "Go on by itself");
  }

  function begin() {
    if (!isOver() || !isOn()) return;
    count(SECONDS);
    announce(`${title(next().short_name)} starts in ${SECONDS} seconds.`);
  }

  // The clock stops after the last step.
  race.on("ended", () => nextFrame(begin));
  stage.on("change", draw);
}
