// What the network thinks of each action, as bars, and how far its first choice lies ahead.
import { el, setText } from "./dom.js";
import { ARROWS, fixed } from "./format.js";
import { nextFrame } from "./loop.js";

const ACTIONS = ["UP", "DOWN", "LEFT", "RIGHT", "WAIT"];

/** @param {HTMLElement} root @param {import("./context.js").Context} context */
export function mountThinking(root, context) {
  const { player } = context;
  const bars = ACTIONS.map((action) => {
    const value = el("span.q-value");
    const node = el(
      "li.q",
      { data: { action } },
      el("span.q-action", el("i", { "aria-hidden": "true", text: ARROWS[action] }), el("span", { text: action })),
      el("div.q-bar", { "aria-hidden": "true" }, el("i")),
      value,
    );
    return { action, node, value };
  });
  const lead = el("span.confidence-text", { id: "confidence" });
  const meter = el("div.confidence-bar", { "aria-hidden": "true" }, el("i"));
  const confidence = el("div.confidence", el("span.gauge-name", { text: "Confidence" }), meter, lead);
  const none = el("p.note", { text: "There is no PathQNet for this task.", hidden: true });
  const arrows = el("input", { type: "checkbox", id: "show-arrows", checked: true, "aria-label": "Arrows on the map" });
  arrows.addEventListener("change", () => context.emit("arrows"));
  const list = el(
    "ol.q-list",
    { id: "q-values", "aria-label": "Value of each action" },
    ...bars.map(({ node }) => node),
  );
  root.append(
    el(
      "div.panel-head",
      el("h2.eyebrow", { text: "What PathQNet thinks" }),
      el("label.switch", arrows, el("span", { text: "Arrows" })),
    ),
    list,
    confidence,
    none,
  );

  function draw() {
    const { frame } = player;
    if (!frame) return;
    const values = frame.q_values;
    none.hidden = values !== null || frame.done;
    list.hidden = confidence.hidden = !none.hidden;
    if (!values) {
      for (const bar of bars) {
        setText(bar.value, "–");
        bar.node.style.setProperty("--share", "0");
        bar.node.classList.remove("best");
      }
      setText(lead, "–");
      confidence.style.setProperty("--share", "0");
      return;
    }
    const ranked = ACTIONS.filter((a) => a in values).sort((a, b) => values[b] - values[a]);
    const [best, second] = ranked;
    const least = values[ranked.at(-1)];
    const spread = values[best] - least || 1;
    for (const { action, node, value } of bars) {
      setText(value, fixed(values[action], 3));
      node.style.setProperty("--share", String(0.04 + (0.96 * (values[action] - least)) / spread));
      node.classList.toggle("best", action === best);
    }
    const gap = values[best] - values[second];
    const share = gap / spread;
    confidence.style.setProperty("--share", String(share));
    setText(lead, `${best} leads ${second} by ${fixed(gap, 3)}`);
  }

  player.on("change", () => nextFrame(draw));
}
