// Which view is shown: that of the address.
import { toast } from "./dom.js";

const TITLES = { fly: "Fly", compare: "Compare pilots", learn: "Learn", api: "API and logs", draw: "Draw a map" };

/** @param {import("./context.js").Context} context */
export function mountViews(context) {
  const { router, live } = context;
  const links = [...document.querySelectorAll(".views a")];

  function show({ view, unread }) {
    if (unread.length) toast(`Not understood in the address: ${unread.join(", ")}. The rest of it is shown.`);
    const first = !document.body.dataset.view;
    // What another view wants to hear, it asks for itself.
    if (context.view !== view) live.subscribe([]);
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
    context.emit("view", view);
  }

  // The greeting goes with the first half of a double click on it: what lies there then is not meant by the second.
  let greeted = null;
  const onGreeting = (event) => {
    if (event.detail < 2) greeted = event.target.closest("#hello");
    else if (greeted?.hidden) {
      event.preventDefault();
      event.stopPropagation();
    }
  };
  for (const type of ["mousedown", "click"]) document.addEventListener(type, onGreeting, true);

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
