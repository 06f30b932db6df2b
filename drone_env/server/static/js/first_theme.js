// Dark or light before the first paint: a plain script, since modules run after it. theme.js goes on from here.
(() => {
  let chosen = null;
  try {
    chosen = localStorage.getItem("drone-env-theme");
  } catch {
    // Storage can be forbidden, as in a frame of another site: the system's choice then.
  }
  const system = matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark";
  document.documentElement.dataset.theme = chosen === "light" || chosen === "dark" ? chosen : system;
})();
