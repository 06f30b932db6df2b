// The list of moves, with marks as in chess once the flight is annotated.
import { announce, el, setText } from "./dom.js";
import { ARROWS, percent, points } from "./format.js";

/** From best to worst, with their plurals. */
const LABELS = { best: "best", good: "good", inaccuracy: "inaccuracies", mistake: "mistakes", blunder: "blunders" };
const QUIET = new Set(["step", "wait", null]);

/** @param {HTMLElement} root @param {Context} context */
export function mountMoves(root, context) {
  const { stage } = context;
  const summary = el("div.accuracy");
  const list = el("ol.moves", { id: "moves", "aria-label": "Moves" });
  const detail = el("p.note.move-detail", { id: "move-detail", "aria-live": "off" });
  root.append(el("h2.eyebrow", { text: "Moves" }), summary, list, detail);
  let shown = null;
  let annotation = null;
  let calls = null;
  let announced = 0;

  function draw() {
    const { track, clock } = stage;
    const news = track?.annotation !== annotation || track?.calls !== calls;
    if (track !== shown || news || (track && list.childElementCount > track.steps)) {
      shown = track;
      annotation = track?.annotation;
      calls = track?.calls;
      list.replaceChildren();
      summary.replaceChildren(...(annotation ? counts(track) : []));
      announced = track?.steps ?? 0;
    }
    if (!track) return;
    const fresh = track.frames.slice(list.childElementCount + 1);
    list.append(...fresh.map((frame) => moveButton(frame, chosenMove(track, frame.step))));
    // The strip announces the end of the flight.
    const isNew = track.live && !track.done && track.steps > announced;
    if (isNew && !QUIET.has(track.last.event)) announce(track.last.message);
    announced = track.steps;
    const step = Math.min(clock.cursor, track.steps);
    mark(list.children[step - 1]?.firstElementChild ?? null);
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

  function moveButton(frame, move) {
    const label = `Step ${frame.step}, ${frame.action}${move ? `, ${move.label}` : ""}`;
    return el(
      "li",
      el(
        "button.move",
        {
          data: { label: move?.label ?? "", event: frame.event },
          "aria-label": label,
          title: frame.message,
          press: () => stage.clock.goTo(frame.step),
        },
        el("span.move-step", { text: String(frame.step) }),
        el("span.move-arrow", { text: ARROWS[frame.action] ?? frame.action }),
        el("span.move-mark", { text: move?.mark ?? "" }),
      ),
    );
  }

  stage.on("change", draw);
}

/** The annotation of a step; undefined without one, and for a wait in place of a language model's unusable answer. */
function chosenMove({ annotation, calls }, step) {
  const answers = calls?.steps.get(step) ?? [];
  return !answers.length || answers.some(({ outcome }) => outcome === "ok") ? annotation?.moves[step - 1] : undefined;
}

function counts(track) {
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

/** A step in words: what happened, what the move lost, and what is still possible. */
export function describe(track, step) {
  const { message, value } = track.frameAt(step);
  const { label, regret, best_actions: best = [] } = track.annotation?.moves[step - 1] ?? {};
  const loss = label && (label === "best" ? "Best move." : `Lost ${points(regret, 2)}. Best move: ${best.join(" or ")}.`);
  return [message, loss, value !== null && `${points(value)} still possible.`].filter(Boolean).join(" ");
}
