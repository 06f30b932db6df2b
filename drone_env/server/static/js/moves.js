// The list of a flight's moves with their marks, as beside a game of chess. Shared by Watch, Race and Replay.
import { el, setText } from "./dom.js";
import { ARROWS, percent, points } from "./format.js";
import { nextFrame } from "./loop.js";

/** From best to worst, with what several of them are called. */
const LABELS = { best: "best", good: "good", inaccuracy: "inaccuracies", mistake: "mistakes", blunder: "blunders" };

/**
 * @param {HTMLElement} root Filled with the list.
 * @param {import("./player.js").Player} player Its `annotation` is listed; a click on a move seeks there.
 * @returns {() => void} Draws it again, with the move that is shown in sight: for a list that was hidden.
 */
export function mountMoves(root, player) {
  const summary = el("div.accuracy");
  const list = el("ol.moves", { "aria-label": "Moves" });
  const detail = el("p.note.move-detail", { "aria-live": "off" });
  root.classList.add("annotated");
  root.append(summary, list, detail);
  let shown = null;
  let marked = null;

  function draw() {
    const { annotation, cursor } = player;
    if (annotation !== shown) {
      shown = annotation;
      list.replaceChildren(...(annotation?.moves ?? []).map(moveButton));
      summary.replaceChildren(...(annotation ? counts(annotation) : []));
      marked = null;
    }
    if (!annotation) {
      setText(detail, "");
      return;
    }
    marked?.removeAttribute("aria-current");
    marked = list.children[cursor - 1]?.firstElementChild ?? null;
    marked?.setAttribute("aria-current", "step");
    if (marked) keepInSight(list, marked);
    setText(detail, describe(annotation, cursor));
  }

  function moveButton(move) {
    return el(
      "li",
      el(
        "button.move",
        {
          data: { label: move.label },
          "aria-label": spoken(move),
          press: () => player.seek(move.step),
        },
        el("span.move-step", { text: String(move.step) }),
        el("span.move-arrow", { text: ARROWS[move.action] ?? move.action }),
        el("span.move-mark", { text: move.mark }),
      ),
    );
  }

  player.on("change", () => nextFrame(draw));
  draw();
  return draw;
}

function counts(annotation) {
  const chips = Object.keys(LABELS)
    .filter((label) => annotation.counts[label])
    .map((label) => {
      const count = annotation.counts[label];
      return el(
        "span.move-count",
        { data: { label } },
        el("i", { "aria-hidden": "true" }),
        el("span", { text: `${count} ${count > 1 ? LABELS[label] : label}` }),
      );
    });
  const accuracy = annotation.accuracy === null ? "–" : percent(annotation.accuracy);
  return [
    el("p.accuracy-head", el("strong", { text: accuracy }), el("span", { text: " accuracy" })),
    el("div.move-counts", ...chips),
  ];
}

function spoken(move) {
  return `Step ${move.step}, ${move.action}, ${move.label}`;
}

function describe(annotation, cursor) {
  const move = annotation.moves[cursor - 1];
  if (!move)
    return `Optimum of this map: ${points(annotation.optimal_score)} in ${annotation.optimal_steps} steps. This flight gave away ${points(annotation.regret)}.`;
  const best = move.best_actions.join(" or ");
  if (move.label === "best") return `Step ${move.step}: ${move.action} gives nothing away.`;
  return `Step ${move.step}: ${move.action} gives away ${points(move.regret, 2)}. Best was ${best}.`;
}

/** Scrolls the list alone, never the page. */
function keepInSight(list, node) {
  const top = node.offsetTop - list.offsetTop;
  if (top < list.scrollTop || top + node.offsetHeight > list.scrollTop + list.clientHeight) {
    list.scrollTop = top - list.clientHeight / 2;
  }
}
