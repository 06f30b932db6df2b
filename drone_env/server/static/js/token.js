// Asks for the token of a server that wants one.
import { el } from "./dom.js";

let asking = null;

/** @param {boolean} wrong Whether there was a token, which the server refused. @returns {Promise<string>} */
export function askForToken(wrong) {
  asking ??= ask(wrong).finally(() => {
    asking = null;
  });
  return asking;
}

function ask(wrong) {
  const dialog = document.getElementById("token");
  const input = el("input.input", {
    type: "password",
    id: "token-input",
    autocomplete: "current-password",
    required: true,
  });
  const form = el(
    "form",
    { method: "dialog" },
    el("h2", { id: "token-title", text: "This server asks for a token" }),
    el("p.note", {
      text: wrong
        ? "The token was refused. Try another."
        : "It is the value of DRONE_ENV_TOKEN that the server was started with. It is kept for this tab.",
    }),
    el("label.eyebrow", { for: "token-input", text: "Token" }),
    input,
    el("button.button.primary", { type: "submit", text: "Enter" }),
  );
  dialog.replaceChildren(form);
  if (!dialog.open) dialog.showModal();
  return new Promise((resolve) => {
    let given = null;
    form.addEventListener("submit", () => {
      given = input.value.trim();
    });
    // Without a token there is no page. "cancel" is no help: browsers let the second Escape through.
    dialog.onclose = () => (given === null ? dialog.showModal() : resolve(given));
  });
}
