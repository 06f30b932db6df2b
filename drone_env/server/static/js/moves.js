// What happened, step by step: in the server's words, and once a flight is annotated its moves with their marks, as beside
// a game of chess.
import { announce, el, setText } from "./dom.js";
import { ARROWS, percent, points, signed } from "./format.js";

/** From best to worst, with what several of them are called. */
const LABELS = { best: "best", good: "good", inaccuracy: "inaccuracies", mistake: "mistakes", blunder: "blunders" };
const QUIET = new Set(["step", "wait", null]);

/** @param {HTMLElement} root @param {import("./context.js").Context} context */
export function mountMoves(root, context) {
  const { stage } = context;
  const summary = el("div.accuracy");
  const list = el("ol.moves", { id: "moves", "aria-label": "Moves" });
  const detail = el("p.note.move-detail", { id: "move-detail", "aria-live": "off" });
  root.append(el("h2.eyebrow", { text: "Moves" }), summary, list, detail);
  let shown = null;
  let annotation = null;
  let marked = null;
  let heard = 0;

  function draw() {
    const { track, clock } = stage;
    if (track !== shown || track?.annotation !== annotation || (track && list.childElementCount > track.steps)) {
      shown = track;
      annotation = track?.annotation ?? null;
      list.replaceChildren();
      summary.replaceChildren(...(annotation ? counts(annotation) : []));
      heard = track?.steps ?? 0;
    }
    if (!track) return;
    const fresh = track.frames.slice(list.childElementCount + 1);
    list.append(...fresh.map((frame) => moveButton(frame, annotation?.moves[frame.step - 1])));
    // How it has ended is said below the map.
    const told = track.live && !track.done && track.steps > heard;
    if (told && !QUIET.has(track.last.event)) announce(track.last.message);
    heard = track.steps;
    const step = Math.min(clock.cursor, track.steps);
    mark(list.children[step - 1]?.firstElementChild ?? null);
    setText(detail, describe(track, step));
  }

  function mark(button) {
    if (button === marked) return;
    marked?.removeAttribute("aria-current");
    marked = button;
    sight.disconnect();
    if (!button) return;
    button.setAttribute("aria-current", "step");
    sight.observe(button);
  }

  // Asked for while a frame is made, the place of a button would cost a layout of the page.
  const sight = new IntersectionObserver(
    ([{ target, intersectionRatio }]) => {
      sight.disconnect();
      // Scrolls the list alone, never the page.
      if (intersectionRatio < 0.9) list.scrollTop = target.offsetTop - list.offsetTop - list.clientHeight / 2;
    },
    { root: list },
  );

  function moveButton(frame, move) {
    const said = `Step ${frame.step}, ${frame.action}${move ? `, ${move.label}` : ""}`;
    return el(
      "li",
      el(
        "button.move",
        {
          data: { label: move?.label ?? "", event: frame.event },
          "aria-label": said,
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

/** The step that is shown, in words: what happened, and what it gave away. */
function describe(track, step) {
  const frame = track.frameAt(step);
  const reward = frame.step ? ` Reward ${signed(frame.reward, 3)}.` : "";
  const move = track.annotation?.moves[step - 1];
  if (!move) return `${frame.message}${reward}`;
  const gave =
    move.label === "best"
      ? "Nothing lost."
      : `Lost ${points(move.regret, 2)}: best was ${move.best_actions.join(" or ")}.`;
  return `${frame.message} ${gave}${reward}`;
}
