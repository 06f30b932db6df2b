// Sets the theme before the first paint. Modules would run too late; main.js handles later changes and clicks.
(() => {
  let chosen = null;
  try {
    chosen = localStorage.getItem("drone-env-theme");
  } catch {
    // Storage is blocked, as in a cross-site frame: use the system's theme.
  }
  const system = matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark";
  const theme = chosen === "light" || chosen === "dark" ? chosen : system;
  document.documentElement.dataset.theme = theme;
  // Swagger UI's name for it, at `/docs`.
  document.documentElement.classList.toggle("dark-mode", theme === "dark");

  // A click on a link before the modules run only changes the address, which they then show: a load would start again.
  document.addEventListener("click", (event) => {
    const link = event.target instanceof Element && event.target.closest("a[data-view], a[href^='?']");
    if (!(link instanceof HTMLAnchorElement) || document.body.dataset.view || event.ctrlKey || event.metaKey || event.shiftKey) return;
    event.preventDefault();
    history.pushState(null, "", link.href);
  });
})();
