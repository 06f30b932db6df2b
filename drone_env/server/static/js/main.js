// Boots the page: asks the server what there is, then mounts the parts.
import { createApi } from "./api.js";
import { createContext } from "./context.js";
import { toast } from "./dom.js";
import { loadFigures } from "./figures.js";
import { Live } from "./live.js";
import { mountStage } from "./stage.js";
import { Router } from "./router.js";
import { askForToken } from "./token.js";
import { mountViews } from "./views.js";
import { mountTheme } from "./theme.js";
import { mountConnection } from "./connection.js";
import * as history from "./history.js";
import * as replay from "./replay.js";

async function boot() {
  const api = createApi(askForToken);
  const figures = loadFigures();
  const [{ tasks, reward_profiles }, { pilots, most }, { kinds }] = await firstAnswers(api);
  await figures;
  const live = new Live(api.protocols);
  const router = new Router();
  const context = createContext({ router, api, live, tasks, rewardProfiles: reward_profiles, pilots, most, kinds });
  const part = (id) => document.getElementById(id);

  mountTheme(context);
  mountConnection(context);
  mountStage(context);
  for (const [id, view] of Object.entries({ history, replay })) view.mount(part(`view-${id}`), context);
  mountLater(context, { learn: "./learn.js", api: "./api_view.js" });
  mountViews(context);
  live.connect();
}

/** Views that are loaded when they are first shown. @param {Object<string, string>} modules By view. */
function mountLater(context, modules) {
  const waiting = new Map(Object.entries(modules));
  context.on("view", async (view) => {
    const module = waiting.get(view);
    if (!waiting.delete(view)) return;
    try {
      (await import(module)).mount(document.getElementById(`view-${view}`), context);
    } catch (error) {
      waiting.set(view, module);
      toast(`The view could not be loaded: ${error.message}`);
    }
  });
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
