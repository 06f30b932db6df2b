// Boots the page: asks the server what there is, then mounts the parts.
import { createApi } from "./api.js";
import { createContext } from "./context.js";
import { mountConnection } from "./connection.js";
import { loadFigures } from "./figures.js";
import { Live } from "./live.js";
import { Router } from "./router.js";
import { mountTheme } from "./theme.js";
import { askForToken } from "./token.js";
import { mountViews } from "./views.js";
import * as api_ from "./api_view.js";
import * as compare from "./compare.js";
import * as fly from "./fly.js";
import * as learn from "./learn.js";

async function boot() {
  const api = createApi(askForToken);
  const figures = loadFigures();
  const [{ tasks, reward_profiles }, { pilots, most }, { kinds }] = await firstAnswers(api);
  await figures;
  const live = new Live(api.protocols);
  const router = new Router();
  const context = createContext({ router, api, live, tasks, rewardProfiles: reward_profiles, pilots, most, kinds });

  mountTheme(context);
  mountConnection(context);
  for (const [name, view] of Object.entries({ fly, compare, learn, api: api_ }))
    view.mount(document.getElementById(`view-${name}`), context);
  mountViews(context);
  live.connect();
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
