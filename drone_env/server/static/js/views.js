// Which view is shown: that of the address.

const TITLES = { fly: "Fly", compare: "Compare pilots", learn: "Learn", api: "API and logs" };

/** @param {import("./context.js").Context} context */
export function mountViews(context) {
  const { router } = context;
  const links = [...document.querySelectorAll(".views a")];

  function show({ view }) {
    const first = !document.body.dataset.view;
    context.view = view;
    document.body.dataset.view = view;
    for (const section of document.querySelectorAll("main > .view")) section.hidden = section.id !== `view-${view}`;
    for (const link of links) {
      if (link.dataset.view === view) {
        link.setAttribute("aria-current", "page");
        if (!first) link.scrollIntoView({ block: "nearest", inline: "nearest" });
      } else link.removeAttribute("aria-current");
    }
    document.getElementById("view-title").textContent = TITLES[view];
    document.title = `${TITLES[view]} · Drone Delivery`;
    if (view !== "fly") document.getElementById("hello")?.remove();
    context.emit("view", view);
  }

  // All links to addresses of this page, wherever they stand: no need to load it anew.
  document.addEventListener("click", (event) => {
    const link = event.target.closest?.("a[data-view], a[href^='?']");
    if (!link || event.ctrlKey || event.metaKey || event.shiftKey) return; // a tab of its own
    event.preventDefault();
    if (link.dataset.view) router.open(link.dataset.view);
    else router.follow(link.href);
  });
  router.on("address", show);
  show(router.address);
}
