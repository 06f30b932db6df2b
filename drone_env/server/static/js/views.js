// Which view is shown: that of the address.
import { isFlown } from "./router.js";

const TITLES = {
  watch: "Watch a flight",
  race: "Race pilots",
  replay: "Replay a flight",
  history: "History of episodes",
  learn: "Learn",
  api: "API",
};

/** @param {import("./context.js").Context} context `emit("replay", id)` and `emit("open", view)` change the view. */
export function mountViews(context) {
  const { router } = context;
  const links = [...document.querySelectorAll(".views a")];

  function show({ view }) {
    const first = !document.body.dataset.view;
    context.view = view;
    document.body.dataset.view = view;
    for (const section of document.querySelectorAll("main > section:not(#hello)")) {
      const shown = section.id === "stage" ? isFlown(view) : section.id === `view-${view}`;
      section.hidden = !shown;
    }
    for (const link of links) {
      if (link.dataset.view === view) {
        link.setAttribute("aria-current", "page");
        if (!first) link.scrollIntoView({ block: "nearest", inline: "nearest" });
      } else link.removeAttribute("aria-current");
    }
    document.getElementById("view-title").textContent = TITLES[view];
    document.title = `${TITLES[view]} · Drone Delivery`;
    if (view !== "watch") document.getElementById("hello")?.remove();
    context.emit("view", view);
  }

  for (const link of links) {
    link.addEventListener("click", (event) => {
      if (event.ctrlKey || event.metaKey || event.shiftKey) return; // a tab of its own
      event.preventDefault();
      router.open(link.dataset.view);
    });
  }
  router.on("address", show);
  context.on("open", (view) => router.open(view));
  context.on("replay", (episode) => router.go({ view: "replay", episode }));
  show(router.address);
}
