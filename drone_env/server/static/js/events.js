// What happened, step by step, in the server's words; once a flight is annotated, its moves with their marks.
import { announce, el, setText } from "./dom.js";
import { signed } from "./format.js";
import { nextFrame } from "./loop.js";
import { mountMoves } from "./moves.js";

const QUIET = new Set(["step", "wait", null]);

/** @param {HTMLElement} root @param {import("./context.js").Context} context */
export function mountEvents(root, context) {
  const { player } = context;
  const list = el("ol.events", { id: "events", tabindex: "0", "aria-label": "Messages" });
  const moves = el("div", { hidden: true });
  const heading = el("h2.eyebrow", { text: "Messages" });
  const explain = el("button.button.small", {
    id: "explain",
    text: "Annotate the moves",
    hidden: true,
    press: () => context.emit("explain", player),
  });
  root.append(el("div.panel-head", heading, explain), list, moves);
  mountMoves(moves, player);
  let written = 0;

  function reset() {
    list.replaceChildren();
    written = 0;
    write();
  }

  function write() {
    const annotated = player.annotation !== null;
    list.hidden = annotated;
    moves.hidden = !annotated;
    explain.hidden = annotated || !player.episode;
    setText(heading, annotated ? "Moves" : "Messages");
    const { frames } = player;
    const fresh = frames.slice(written);
    if (!fresh.length) return;
    written = frames.length;
    const nodes = fresh.map((frame) =>
      el(
        "li",
        { data: { event: frame.event ?? "reset" } },
        el("span.event-step", { text: String(frame.step) }),
        el("span.event-text", { text: frame.message }),
        el("span.event-reward", { text: frame.step ? signed(frame.reward, 2) : "" }),
      ),
    );
    list.prepend(...nodes.reverse());
    const { last } = player;
    if (!QUIET.has(last.event) || last.done) announce(last.message);
  }

  player.on("load", reset);
  player.on("frames", () => nextFrame(write));
}
