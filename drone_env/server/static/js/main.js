// Boots the page: loads the catalogue from the server, then mounts the views.
import { createApi } from "./api.js";
import { mountApi } from "./api_view.js";
import { forgetColours, recall, remember } from "./base.js";
import { mountCompare } from "./compare.js";
import { createContext } from "./context.js";
import { announce, setText, toast } from "./dom.js";
import { mountEditor } from "./editor.js";
import { loadFigures } from "./figures.js";
import { mountFly } from "./fly.js";
import { mountLearn } from "./learn.js";
import { linkOf, Router } from "./router.js";
import { Server } from "./server.js";

/** What fills each view beside Fly at its first visit. */
const MOUNTS = { compare: mountCompare, learn: mountLearn, api: mountApi, draw: mountEditor };

async function boot() {
  const api = createApi();
  const figures = loadFigures();
  const [{ tasks }, { pilots, most }, { kinds }] = await Promise.all([api.get("tasks"), api.get("pilots"), api.get("kinds")]);
  await figures;
  const server = new Server(api);
  const router = new Router();
  const context = createContext({ router, api, server, tasks, pilots, most, kinds });

  mountTheme(context);
  mountConnection(context);
  mountFly(document.getElementById("view-fly"), context);
  mountViews(context);
}

const THEME = "drone-env-theme";

/** Switches between dark and light; before_modules.js has set the first one. Emits "theme". @param {Context} context */
function mountTheme(context) {
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
    remember(THEME, theme);
    apply(theme);
  });
  system.addEventListener("change", () => recall(THEME) ?? apply(system.matches ? "light" : "dark"));
  apply(document.documentElement.dataset.theme);
}

const other = (theme) => (theme === "dark" ? "light" : "dark");

/** Shows whether the server answers: a dot in the top bar, and a banner while it is away. @param {Context} context */
function mountConnection({ server, stage }) {
  const dot = document.getElementById("connection");
  const banner = document.getElementById("banner");

  document.getElementById("banner-retry").addEventListener("click", () => server.look());
  function show({ state }) {
    dot.dataset.state = state;
    setText(dot.lastElementChild, state === "open" ? "Live" : "Server away");
    if (state === "open" && !banner.hidden) announce("The server is back.");
    banner.hidden = state === "open";
    const kept = stage.tracks.some((track) => track.live && !track.done) ? " Your flight is kept." : "";
    setText(document.getElementById("banner-text"), `The server is away.${kept}`);
  }
  server.on("state", show);
  show(server);
}

/** Shows the view of the address. @param {Context} context */
function mountViews(context) {
  const { router, server } = context;
  /** @type {NodeListOf<HTMLElement>} */
  const sections = document.querySelectorAll("main > .view");
  /** @type {NodeListOf<HTMLAnchorElement>} */
  const links = document.querySelectorAll(".views a");

  function show({ view, unread }) {
    const first = !document.body.dataset.view;
    const section = document.getElementById(`view-${view}`);
    // Each view asks for its own news.
    if (context.view !== view) server.watch([]);
    context.view = document.body.dataset.view = view;
    for (const one of sections) one.hidden = one !== section;
    MOUNTS[view]?.(section, context);
    delete MOUNTS[view];
    if (unread.length) toast(`The link contains invalid values, which were ignored: ${unread.join(", ")}.`);
    for (const link of links) {
      link.ariaCurrent = link.dataset.view === view ? "page" : null;
      // That of Fly leads back to the last flight.
      if (link.dataset.view === "fly") link.href = linkOf(router.flight).href;
      if (link.ariaCurrent && !first) link.scrollIntoView({ block: "nearest", inline: "nearest" });
    }
    document.getElementById("view-title").textContent = section.ariaLabel;
    document.title = `${section.ariaLabel} · Drone Delivery`;
    context.emit("view", view);
  }

  router.on("address", show);
  show(router.address);
}

boot().catch((error) => {
  document.getElementById("banner").hidden = false;
  document.getElementById("banner-text").textContent = `The page could not start: ${error.message}`;
  document.getElementById("banner-retry").addEventListener("click", () => location.reload());
  if (!error.status) console.error(error);
});
