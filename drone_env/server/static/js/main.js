// Boots the page: asks the server what there is, then mounts the parts.
import { createApi } from "./api.js";
import { createContext } from "./context.js";
import { mountConnection } from "./connection.js";
import { el, loaded } from "./dom.js";
import { loadFigures } from "./figures.js";
import { Live } from "./live.js";
import { Router } from "./router.js";
import { mountTheme } from "./theme.js";
import { mountViews } from "./views.js";
import { mountFly } from "./fly.js";

/** Views that are loaded when they are first shown: most visits never come to them. */
const LATER = { compare: "compare", learn: "learn", api: "api_view", draw: "editor" };

async function boot() {
  const api = createApi(async (wrong) => (await import("./token.js")).askForToken(wrong));
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

boot().catch((error) => {
  document.getElementById("banner").hidden = false;
  document.getElementById("banner-text").textContent = `The page could not start: ${error.message}`;
  document.getElementById("banner-retry").addEventListener("click", () => location.reload());
  if (!error.status) console.error(error);
});
