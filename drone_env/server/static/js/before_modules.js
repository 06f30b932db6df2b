// Sets the theme before the first paint, and follows links. Modules would run too late; main.js handles later changes.
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

  // A click on a link within the page only changes the address, also before the modules run: a load would start again.
  document.addEventListener("click", (event) => {
    const link = event.target instanceof Element && event.target.closest("a[data-view], a[href^='?']");
    if (!(link instanceof HTMLAnchorElement) || event.ctrlKey || event.metaKey || event.shiftKey) return; // opens another tab
    event.preventDefault();
    if (link.href !== location.href) history.pushState(null, "", link.href);
    window.dispatchEvent(new PopStateEvent("popstate"));
  });
})();
