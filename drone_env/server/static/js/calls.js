// Beside a language model's flight: what it was asked at the step that is shown, and what it answered.
import { el, setText } from "./dom.js";

/** @param {HTMLElement} root @param {import("./context.js").Context} context */
export function mountCalls(root, context) {
  const { stage } = context;
  const model = el("h2.eyebrow");
  const answer = el("pre.raw", { id: "llm-answer", tabindex: "0", "aria-label": "Answer" });
  const prompt = el("pre.raw", { id: "llm-prompt", tabindex: "0", "aria-label": "Prompt" });
  const note = el("p.note");
  root.append(model, note, answer, el("details", el("summary", { text: "What it was asked" }), prompt));

  function draw() {
    const { track, clock } = stage;
    root.hidden = !track?.calls;
    if (root.hidden) return;
    setText(model, `Prompt and answer: ${track.calls.model}`);
    // The move of the step that is shown; at the start, the first.
    const call = track.calls.steps.get(Math.max(1, Math.min(clock.cursor, track.steps)));
    setText(note, call ? `Step ${call.step}: ${call.outcome}` : "No call for this step: it follows from the one before.");
    setText(answer, call?.answer ?? "");
    setText(prompt, (call?.messages ?? []).map(({ role, content }) => `${role}: ${textOf(content)}`).join("\n\n"));
  }

  stage.on("change", draw);
}

const textOf = (content) => (typeof content === "string" ? content : JSON.stringify(content, null, 1));
