// Which view is shown: the hash of the address says it, so that "back" works and a view can be linked.

const TITLES = {
  watch: "Watch a flight",
  race: "Race pilots",
  replay: "Replay a flight",
  history: "History of episodes",
  specs: "Technical specifications",
  logs: "Logs",
};

/** @param {import("./context.js").Context} context `emit("replay", id)` and `emit("open", view)` change the view. */
export function mountViews(context) {
  /** What an address without a view shows: what it opened with, whatever has been looked at since. */
  const home = context.view;

  function show() {
    const name = location.hash.slice(1);
    const view = Object.hasOwn(TITLES, name) ? name : home;
    const first = !document.body.dataset.view;
    context.view = view;
    document.body.dataset.view = view;
    document.getElementById("stage").hidden = view !== "watch" && view !== "race";
    for (const other of ["replay", "history", "specs", "logs"]) document.getElementById(other).hidden = view !== other;
    for (const link of document.querySelectorAll(".views a")) {
      if (link.dataset.view === view) {
        link.setAttribute("aria-current", "page");
        if (!first) link.scrollIntoView({ block: "nearest", inline: "nearest" });
      } else link.removeAttribute("aria-current");
    }
    document.getElementById("view-title").textContent = TITLES[view];
    document.title = `${TITLES[view]} · Drone Delivery`;
    if (location.hash) document.getElementById("hello")?.remove();
    context.emit("view", view);
  }

  const open = (view) => {
    if (location.hash.slice(1) === view) show();
    else location.hash = view;
  };
  // Not "hashchange": browsers leave it out where the link before the hash differs too.
  window.addEventListener("popstate", show);
  context.on("open", open);
  context.on("replay", () => open("replay"));
  show();
}
