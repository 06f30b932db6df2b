// The list of moves, with marks as in chess once the flight is annotated; a loop is one entry.
import { announce, el, setText } from "./dom.js";
import { ARROWS, counted, percent, points } from "./format.js";

/** From best to worst, with their plurals. */
const LABELS = { best: "best", good: "good", inaccuracy: "inaccuracies", mistake: "mistakes", blunder: "blunders" };
const QUIET = new Set(["step", "wait", null]);

/** @param {HTMLElement} root @param {Context} context */
export function mountMoves(root, context) {
  const { stage } = context;
  const [summary, list, detail] = root.querySelectorAll("div, ol, p");
  let shown = null;
  let annotation = null;
  let calls = null;
  /** The button of each step from 1 on; a loop has one for all its steps. @type {HTMLElement[]} */
  let buttons = [];

  function draw() {
    const { track, clock } = stage;
    const news = track?.annotation !== annotation || track?.calls !== calls;
    const anew = track !== shown || news || (track && buttons.length > track.steps);
    if (anew) {
      shown = track;
      annotation = track?.annotation;
      calls = track?.calls;
      buttons = [];
      list.replaceChildren();
      summary.replaceChildren(...(annotation ? counts(track) : []));
    }
    if (!track) return;
    // The card announces the end of the flight, the map in words each move of the visitor.
    const isNew = !anew && buttons.length < track.steps && track.live && !track.done && !track.byHand;
    if (isNew && !QUIET.has(track.last.event)) announce(track.last.message);
    while (buttons.length < track.steps) {
      const frame = track.frames[buttons.length + 1];
      const loop = loopAt(track, frame.step);
      const button = loop ? loopButton(loop) : moveButton(frame, chosenMove(track, frame.step));
      list.append(el(loop ? "li.loop" : "li", button));
      for (let step = frame.step; step <= (loop?.last ?? frame.step); step++) buttons.push(button);
    }
    const step = Math.min(clock.cursor, track.steps);
    mark(buttons[step - 1] ?? null);
    setText(detail, describe(track, step));
  }

  function mark(button) {
    const marked = list.querySelector("[aria-current]");
    if (button === marked) return;
    marked?.removeAttribute("aria-current");
    if (!button) return;
    button.setAttribute("aria-current", "step");
    // Scrolls the list, not the page.
    list.scrollTop = button.offsetTop - list.offsetTop - list.clientHeight / 2;
  }

  const moveButton = ({ step, action, event, message }, { label = "", mark = "" } = {}) =>
    entry(step, `Step ${step}, ${action}${label && `, ${label}`}`, { label, event }, message, step, ARROWS[action], mark);

  function loopButton({ first, last, actions, label, mark, words }) {
    const rounds = (last - first + 1) / actions.length;
    const name = `Steps ${first} to ${last}, ${actions.join(", ")}, ${counted(rounds, "time")}: ${words}`;
    const arrows = `${actions.map((action) => ARROWS[action]).join(" ")} × ${rounds}`;
    return entry(first, name, { label: label ?? "" }, words, `${first} to ${last}`, arrows, mark);
  }

  /** The texts are the steps, the arrows and the mark. */
  function entry(step, name, data, title, ...texts) {
    const parts = ["step", "arrow", "mark"].map((part, i) => el(`span.move-${part}`, { text: texts[i] }));
    return el("button.move", { data, "aria-label": name, title, press: () => stage.clock.goTo(step) }, ...parts);
  }

  stage.on("change", draw);
}

/** The annotation of a step; undefined without one, and for a wait in place of a language model's unusable answer. */
function chosenMove({ annotation, calls }, step) {
  const answers = calls?.steps.get(step) ?? [];
  return !answers.length || answers.some(({ outcome }) => outcome === "ok") ? annotation?.moves[step - 1] : undefined;
}

/** The loop that contains a step. */
const loopAt = ({ annotation }, step) => annotation?.loops.find(({ first, last }) => first <= step && step <= last);

function counts(track) {
  if (track.annotation.unsolved) return [el("p", { text: `No marks: ${track.annotation.unsolved}.` })];
  const moves = track.annotation.moves.filter(({ step }) => chosenMove(track, step));
  const chips = Object.keys(LABELS).flatMap((label) => {
    const count = moves.filter((move) => move.label === label).length;
    const text = `${count} ${count > 1 ? LABELS[label] : label}`;
    const chip = el("span.move-count", { data: { label } }, el("i", { "aria-hidden": "true" }), el("span", { text }));
    return count ? [chip] : [];
  });
  const decisive = moves.filter(({ margin }) => margin > 0);
  const best = decisive.filter(({ regret }) => regret === 0);
  const accuracy = decisive.length ? percent(best.length / decisive.length) : "–";
  return [
    el("p.accuracy-head", el("strong", { text: accuracy }), el("span", { text: " accuracy" })),
    el("div.move-counts", ...chips),
  ];
}

/** A step in words: what happened, what the move or its loop lost, and what is still possible. */
export function describe(track, step) {
  const { message, value } = track.frameAt(step);
  const { label, regret, best_actions: best = [] } = track.annotation?.moves[step - 1] ?? {};
  const loop = loopAt(track, step);
  const loss = label && (label === "best" ? "Best move." : `Lost ${points(regret, 2)}. Best move: ${best.join(" or ")}.`);
  const round = loop && `Steps ${loop.first} to ${loop.last}: ${loop.words}${loop.regret ? `, lost ${points(loop.regret)}` : ""}.`;
  return [message, loss, round, value !== null && `${points(value)} still possible.`].filter(Boolean).join(" ");
}
