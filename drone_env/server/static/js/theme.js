// Dark and light: the system's choice until the visitor makes one, which is remembered. first_theme.js has set it.
import { forgetColours } from "./palette.js";
import { recall, remember } from "./storage.js";

const KEY = "drone-env-theme";

/** @param {import("./context.js").Context} context Told by "theme" when the colours have changed. */
export function mountTheme(context) {
  const button = document.getElementById("theme-button");
  const system = matchMedia("(prefers-color-scheme: light)");

  function apply(theme) {
    document.documentElement.dataset.theme = theme;
    button.setAttribute("aria-label", `Switch to ${other(theme)} colours`);
    forgetColours();
    context.emit("theme", theme);
  }

  button.addEventListener("click", () => {
    const theme = other(document.documentElement.dataset.theme);
    remember(KEY, theme);
    apply(theme);
  });
  system.addEventListener("change", () => recall(KEY) ?? apply(system.matches ? "light" : "dark"));
  apply(document.documentElement.dataset.theme);
}

const other = (theme) => (theme === "dark" ? "light" : "dark");
