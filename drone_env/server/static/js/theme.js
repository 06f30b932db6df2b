// Dark and light: the system's choice until the visitor makes one, which is remembered. first_theme.js has set it.
import { forgetPalette } from "./palette.js";

const KEY = "drone-env-theme";

/** @param {import("./context.js").Context} context Told by "theme" when the colours have changed. */
export function mountTheme(context) {
  const button = document.getElementById("theme-button");
  const system = matchMedia("(prefers-color-scheme: light)");

  function apply(theme) {
    document.documentElement.dataset.theme = theme;
    button.setAttribute("aria-label", `Switch to ${other(theme)} colours`);
    forgetPalette();
    context.emit("theme", theme);
  }

  button.addEventListener("click", () => {
    const theme = other(document.documentElement.dataset.theme);
    keep(theme);
    apply(theme);
  });
  system.addEventListener("change", () => kept() ?? apply(system.matches ? "light" : "dark"));
  apply(document.documentElement.dataset.theme);
}

const other = (theme) => (theme === "dark" ? "light" : "dark");

function kept() {
  try {
    return localStorage.getItem(KEY);
  } catch {
    return null;
  }
}

// Storage can be forbidden, as in a frame of another site: the choice then lasts as long as the page.
function keep(theme) {
  try {
    localStorage.setItem(KEY, theme);
  } catch {
    return;
  }
}
