// Watch and Race: puts plan, maps, controls and instruments together.
import { ApiError } from "./api.js";
import { mountControls } from "./controls.js";
import { mountDeck } from "./deck.js";
import { el, toast } from "./dom.js";
import { mountEvents } from "./events.js";
import { Fleet } from "./fleet.js";
import { mountHelp } from "./help.js";
import { mountHuman } from "./human.js";
import { mountInstruments } from "./instruments.js";
import { mountKeys } from "./keys.js";
import { mountLegend } from "./legend.js";
import { mountPlan } from "./plan.js";
import { mountResults } from "./results.js";
import { isFlown, says } from "./router.js";
import { mountStandings } from "./standings.js";
import { mountTelemetry } from "./telemetry.js";
import { mountThinking } from "./thinking.js";

/** @param {import("./context.js").Context} context @returns {Fleet} */
export function mountStage(context) {
  const part = (id) => document.getElementById(id);
  const fleet = new Fleet(context);
  const side = part("side");
  const panel = (name, mount, ...more) => {
    const node = el(`section.panel.${name}`);
    side.append(node);
    return mount(node, context, ...more);
  };

  mountPlan(part("plan"), context, fleet);
  mountLegend(part("plan"), context);
  const deck = mountDeck(part("deck"), context, fleet);
  const controls = el("div.controls-panel");
  part("deck").append(controls);
  const timeline = mountControls(controls, context, fleet);
  mountHuman(controls, context, fleet);
  const chart = panel("standings-panel", mountStandings, fleet);
  panel("instruments", mountInstruments);
  panel("thinking", mountThinking);
  panel("messages", mountEvents);
  panel("telemetry-panel", mountTelemetry, fleet, {
    maps: () => deck.maps,
    charts: () => (deck.maps.length > 1 ? [timeline.canvas, chart] : [timeline.canvas]),
  });
  const help = mountHelp(context);
  mountKeys(context, fleet, { help });
  mountGhost(context, deck);
  mountResults(context, fleet);

  context.on("explain", (player) => explain(context, player));
  context.on("select", (i) => deck.select(i));
  const arrows = () => deck.maps.forEach((map) => map.show({ values: part("show-arrows").checked }));
  context.on("arrows", arrows);
  context.on("maps", arrows);
  context.on("missions", () => {
    if (isFlown(context.view)) context.router.flies(fleet.setup);
  });
  context.on("ended", (i) => {
    if (context.players.filter((player) => !player.empty).length > 1) explain(context, context.players[i]);
  });
  // The flight that the server has put above the stage has said its word once one is flown here.
  for (const player of context.players) {
    player.on("frames", () => player.last?.step && document.getElementById("hello")?.remove());
  }
  context.on("view", () => follow(context, fleet));
  return fleet;
}

/** Flies what the address says: one pilot in Watch, at least two in Race, on the same map; elsewhere the flight rests. */
function follow({ router, most }, fleet) {
  const { address } = router;
  if (!isFlown(address.view)) {
    if (fleet.playing) fleet.pause();
    return;
  }
  const asked = fleet.asks(address, address.view === "race" ? most : 1);
  if (!fleet.wanted) fleet.want(asked);
  else if (!says(asked, fleet.setup)) fleet.start(asked);
  else router.flies(fleet.setup);
}

/** Annotates a flight that has ended: what each of its moves gave away. Says so where that cannot be. */
async function explain({ api }, player) {
  const { episode } = player;
  if (!episode) return toast("The flight is not stored yet.");
  if (player.annotation) return;
  try {
    const annotation = await api.post("annotate", await api.get(`episodes/${encodeURIComponent(episode.id)}`));
    // Another flight may have begun meanwhile.
    if (player.episode === episode) player.annotate(annotation);
  } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    toast(error.message);
  }
}

/** The switch of the ghost on the best flight: there is one as soon as a flight is annotated. */
function mountGhost(context, deck) {
  const label = document.getElementById("ghost-switch");
  const box = document.getElementById("show-ghost");
  const update = () => {
    const path = context.players.find((player) => player.annotation)?.annotation.optimal_path ?? null;
    label.hidden = path === null;
    document.body.classList.toggle("explained", path !== null);
    for (const map of deck.maps) map.show({ ghost: box.checked && map.player.annotation ? path : null });
  };
  box.addEventListener("change", update);
  for (const player of context.players) player.on("frames", update);
  context.on("maps", update);
}
