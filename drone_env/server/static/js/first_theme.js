// Sets the theme before the first paint. Modules would run too late; main.js handles later changes.
(() => {
  let chosen = null;
  try {
    chosen = localStorage.getItem("drone-env-theme");
  } catch {
    // Storage is blocked, as in a cross-site frame: use the system's theme.
  }
  const system = matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark";
  document.documentElement.dataset.theme = chosen === "light" || chosen === "dark" ? chosen : system;
})();
