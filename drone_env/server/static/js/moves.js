// The list of moves, with marks as in chess once the flight is annotated.
import { announce, el, setText } from "./dom.js";
import { ARROWS, percent, points, signed } from "./format.js";

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
  let announced = 0;

  function draw() {
    const { track, clock } = stage;
    if (track !== shown || track?.annotation !== annotation || (track && list.childElementCount > track.steps)) {
      shown = track;
      annotation = track?.annotation ?? null;
      list.replaceChildren();
      summary.replaceChildren(...(annotation ? counts(annotation) : []));
      announced = track?.steps ?? 0;
    }
    if (!track) return;
    const fresh = track.frames.slice(list.childElementCount + 1);
    list.append(...fresh.map((frame) => moveButton(frame, annotation?.moves[frame.step - 1])));
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

function counts(annotation) {
  const chips = Object.keys(LABELS)
    .filter((label) => annotation.counts[label])
    .map((label) => {
      const count = annotation.counts[label];
      const text = `${count} ${count > 1 ? LABELS[label] : label}`;
      return el("span.move-count", { data: { label } }, el("i", { "aria-hidden": "true" }), el("span", { text }));
    });
  const accuracy = annotation.accuracy === null ? "–" : percent(annotation.accuracy);
  return [
    el("p.accuracy-head", el("strong", { text: accuracy }), el("span", { text: " accuracy" })),
    el("div.move-counts", ...chips),
  ];
}

function describe(track, step) {
  const frame = track.frameAt(step);
  const reward = frame.step ? ` Reward ${signed(frame.reward, 3)}.` : "";
  const move = track.annotation?.moves[step - 1];
  if (!move) return `${frame.message}${reward}`;
  const loss =
    move.label === "best"
      ? "Best move."
      : `Lost ${points(move.regret, 2)}. Best move: ${move.best_actions.join(" or ")}.`;
  return `${frame.message} ${loss}${reward}`;
}
