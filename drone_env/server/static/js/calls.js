// Beside a language model's flight: what it was asked at the step that is shown, and what it answered.
import { el, setText } from "./dom.js";

/** @param {HTMLElement} root @param {import("./context.js").Context} context */
export function mountCalls(root, context) {
  const { stage } = context;
  const model = el("h2.eyebrow");
  const answer = el("pre.raw", { id: "llm-answer", tabindex: "0", "aria-label": "Answer" });
  const prompt = el("pre.raw", { id: "llm-prompt", tabindex: "0", "aria-label": "Prompt" });
  const note = el("p.note");
  const picture = el("img.asked", { loading: "lazy", alt: "The map at this step, as the picture of the prompt shows it" });
  const details = el("details", el("summary", { text: "What it was asked" }), prompt, picture);
  root.append(model, note, answer, details);

  function draw() {
    const { track, clock } = stage;
    root.hidden = !track?.calls;
    if (root.hidden) return;
    setText(model, `Prompt and answer: ${track.calls.model}`);
    // The move of the step that is shown; at the start, the first.
    const step = Math.max(1, Math.min(clock.cursor, track.steps));
    const calls = track.calls.steps.get(step) ?? [];
    setText(note, calls.length ? `For step ${step}` : `For step ${step} it was not asked: an answer before said it, too.`);
    setText(answer, calls.map(answered).join("\n\n"));
    // What was asked last repeats what was asked before.
    const messages = calls.at(-1)?.messages ?? [];
    setText(prompt, messages.map(({ role, content }) => `${role}: ${textOf(content)}`).join("\n\n"));
    picture.hidden = !messages.some(({ content }) => typeof content !== "string");
    // It was asked where the step before had led. An address that is set again is loaded again.
    const shown = picture.hidden ? "" : `preview.png?episode=${encodeURIComponent(track.episode.id)}&step=${step - 1}`;
    if (shown && picture.getAttribute("src") !== shown) picture.src = shown;
    answer.hidden = details.hidden = calls.length === 0;
  }

  stage.on("change", draw);
  draw();
}

/** An answer as it came, and why it was not flown where it could not be used. */
function answered({ attempt, answer, reasoning, failures, outcome }) {
  const said = [reasoning, answer, ...(answer === null ? failures.map(({ reason }) => reason) : [])].filter(Boolean);
  const unusable = outcome === "ok" ? "" : ` (${outcome.replaceAll("_", " ")})`;
  return `${attempt > 1 ? "Asked again: " : ""}${said.join("\n\n")}${unusable}`;
}

/** A text; of a text with a picture also what was shown: it was drawn when it was sent. */
const textOf = (content) =>
  typeof content === "string" ? content : content.map(({ text, image_url }) => text ?? `[${image_url.url}]`).join("\n");
