// Boots the page: asks the server what there is, then mounts the parts.
import { createApi } from "./api.js";
import { forgetColours, recall, remember } from "./base.js";
import { createContext } from "./context.js";
import { announce, el, loaded, setText, toast } from "./dom.js";
import { loadFigures } from "./figures.js";
import { mountFly } from "./fly.js";
import { Live } from "./live.js";
import { Router } from "./router.js";

/** Views that are loaded when they are first shown: most visits never come to them. */
const LATER = { compare: "compare", learn: "learn", api: "api_view", draw: "editor" };

async function boot() {
  const api = createApi();
  const figures = loadFigures();
  const [{ tasks, reward_profiles }, { pilots, most }, { kinds }] = await firstAnswers(api);
  await figures;
  const live = new Live(api.protocols);
  const router = new Router();
  const context = createContext({ router, api, live, tasks, rewardProfiles: reward_profiles, pilots, most, kinds });

  mountTheme(context);
  mountConnection(context);
  mountFly(document.getElementById("view-fly"), context);
  const load = () => LATER[context.view] && mountLater(context.view, context);
  context.on("view", load);
  // What could not be loaded while the server was away.
  live.on("state", ({ state }) => state === "open" && load());
  mountViews(context);
  live.connect();
}

/** Loads a view, which then hears that it is shown. */
async function mountLater(name, context) {
  const file = LATER[name];
  const root = document.getElementById(`view-${name}`);
  delete LATER[name];
  try {
    const style = el("link", { rel: "stylesheet", href: new URL(`../css/${file}.css`, import.meta.url) });
    const [view] = await Promise.all([import(`./${file}.js`), loaded(style)]);
    root.replaceChildren();
    view.mount(root, context);
    if (context.view === name) context.emit("view", name);
  } catch (error) {
    LATER[name] = file;
    console.warn(error);
    const again = el("button.button.small", { text: "Try again", press: () => mountLater(name, context) });
    root.replaceChildren(el("p.problem", { role: "alert" }, "This view could not be loaded. ", again));
  }
}

/** The tasks are asked for first and alone: it is there that a token may be asked for. */
async function firstAnswers(api) {
  const tasks = await api.get("tasks");
  return Promise.all([tasks, api.get("pilots"), api.get("kinds")]);
}

const THEME = "drone-env-theme";

/** Dark and light: the choice of the system until the visitor makes one; first_theme.js has set it. @param {import("./context.js").Context} context Told by "theme" when the colours have changed. */
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

const WORDS = { connecting: "Connecting", open: "Live", away: "Server away", full: "Server full", refused: "Refused" };

/** Shows how the connection is: a dot in the top bar, and a banner while the server is away. @param {import("./context.js").Context} context */
function mountConnection({ live, stage }) {
  const dot = document.getElementById("connection");
  const banner = document.getElementById("banner");
  const text = document.getElementById("banner-text");
  const again = document.getElementById("banner-countdown");

  document.getElementById("banner-retry").addEventListener("click", () => live.connect());
  live.on("state", ({ state, wait, reason }) => {
    dot.dataset.state = state === "open" || state === "connecting" ? state : "away";
    setText(dot.lastElementChild, WORDS[state]);
    if (state === "open") {
      if (!banner.hidden) announce("The server is back.");
      banner.hidden = true;
      return;
    }
    const why = reason ? ` (${reason})` : "";
    const kept = stage.tracks.some((track) => track.live && !track.done) ? " Your flight is kept." : "";
    const words = {
      refused: `The server refused the connection${why}.`,
      full: `The server is full${why}.`,
      away: `The server is away${why}.${kept}`,
    };
    setText(text, words[state]);
    setText(again, state === "refused" ? "" : `Trying again in ${Math.ceil(wait / 1000)} s …`);
    banner.hidden = false;
  });
}

const TITLES = { fly: "Fly", compare: "Compare pilots", learn: "Learn", api: "API and logs", draw: "Draw a map" };

/** Shows the view that the address names. @param {import("./context.js").Context} context */
function mountViews(context) {
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

boot().catch((error) => {
  document.getElementById("banner").hidden = false;
  document.getElementById("banner-text").textContent = `The page could not start: ${error.message}`;
  document.getElementById("banner-retry").addEventListener("click", () => location.reload());
  if (!error.status) console.error(error);
});
