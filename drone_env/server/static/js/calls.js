// The prompt and the answer of a language model at the present step.
import { setText } from "./dom.js";

/** @param {HTMLElement} root @param {Context} context */
export function mountCalls(root, context) {
  const { stage } = context;
  root.append(document.getElementById("calls").content);
  const model = root.querySelector("h2");
  const note = root.querySelector("p");
  const [answer, prompt] = root.querySelectorAll("pre");
  const details = root.querySelector("details");

  function draw() {
    const { track, clock } = stage;
    root.hidden = !track?.calls;
    if (root.hidden) return;
    setText(model, `Prompt and answer: ${track.calls.model}`);
    // At the start, the first step.
    const step = Math.max(1, Math.min(clock.cursor, track.steps));
    const calls = track.calls.steps.get(step) ?? [];
    setText(note, calls.length ? `Step ${step}` : `Step ${step} follows an earlier answer.`);
    setText(answer, calls.map(answered).join("\n\n"));
    // The last request repeats the earlier ones.
    const messages = calls.at(-1)?.messages ?? [];
    setText(prompt, messages.map(({ role, content }) => `${role}: ${content}`).join("\n\n"));
    answer.hidden = details.hidden = calls.length === 0;
  }

  stage.on("change", draw);
}

/** An answer, and the reason if it was unusable. */
function answered({ attempt, answer, failures, outcome }) {
  const text = answer ? [answer.reasoning, answer.tool_arguments || answer.text] : failures.map(({ reason }) => reason);
  const said = text.filter(Boolean);
  const unusable = outcome === "ok" ? "" : ` (${outcome.replaceAll("_", " ")})`;
  return `${attempt > 1 ? "Retry: " : ""}${said.join("\n\n")}${unusable}`;
}
