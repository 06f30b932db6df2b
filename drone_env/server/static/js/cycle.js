// After the flights of pilots over a standard task, the next task starts by itself unless the visitor stays.
import { nextFrame, recall, remember } from "./base.js";
import { announce, setText } from "./dom.js";
import { title } from "./format.js";
import { nextTask } from "./results.js";

/** Key of the visitor's choice: "on" or "off". */
const CYCLE = "drone-env-cycle-pilots";
const SECONDS = 5;

/** @param {HTMLElement} root @param {Context} context @param {Race} race */
export function mountCycle(root, context, race) {
  const { stage, router } = context;
  const [text, button] = root.children;
  let left = 0;
  let timer = 0;

  const isOn = () => recall(CYCLE) !== "off";
  const next = () => nextTask(context.families, stage.world.task);
  /** Whether the flights on the stage have just been flown here, and the visitor looks at their end. */
  function isOver() {
    const { clock, over, world } = stage;
    const flown = race.shown && over && race.human < 0 && !race.starting && !race.tracks.some(({ brought }) => brought);
    return flown && world.task.family === "standard" && !router.address.lesson && !clock.playing && clock.following;
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
    else {
      const task = next();
      count(0);
      const pilots = race.setup.pilots.filter((id) => race.flies(id, task));
      race.start({ task: task.short_name, seed: null, pilots }, { play: true });
    }
  }

  button.addEventListener("click", () => {
    remember(CYCLE, isOn() ? "off" : "on");
    count(isOn() ? SECONDS : 0);
  });

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
