// The maps in the middle: one in Watch, up to four side by side in Race.
import { el, setText } from "./dom.js";
import { isLost, outcome, points } from "./format.js";
import { CityMap } from "./map.js";

/**
 * @param {HTMLElement} root @param {import("./context.js").Context} context @param {import("./fleet.js").Fleet} fleet
 * @returns {{maps: CityMap[], select: (index: number) => void, selected: () => number}} The maps that are shown.
 */
export function mountDeck(root, context, fleet) {
  const grid = el("div.maps", { id: "maps" });
  root.append(grid);
  const deck = { maps: [], cards: [], index: 0 };

  function build(players) {
    deck.maps.forEach((map) => map.destroy());
    grid.replaceChildren();
    grid.dataset.count = players.length;
    deck.cards = players.map((player, i) => card(player, i, players.length > 1));
    deck.maps = deck.cards.map(({ field }, i) => new CityMap(field, players[i], context, i));
    choose(0);
    context.emit("maps", deck.maps);
  }

  function card(player, i, race) {
    const field = el("div.map-field");
    const name = el("span.card-name");
    const state = el("span.card-state");
    const head = race ? el("button.card-head", { "aria-pressed": "false", press: () => choose(i) }, name, state) : null;
    const node = el(
      "figure.card",
      { data: { pilot: player.mission.pilot }, style: { "--lane": `var(--lane-${i + 1})` } },
      head,
      field,
    );
    grid.append(node);
    const made = { node, head, field, name, state, player };
    update(made);
    return made;
  }

  function update({ head, name, state, player }) {
    if (!head || player.empty) return;
    const { frame, mission } = player;
    setText(name, fleet.pilot(mission.pilot).name);
    const lost = isLost(frame.regret) ? ` · −${points(frame.regret)}` : "";
    setText(
      state,
      frame.done
        ? `${points(frame.score)} · ${outcome(frame)}`
        : `step ${frame.step} · ${frame.deliveries_done}/${mission.deliveries_total}${lost}`,
    );
  }

  function choose(i) {
    deck.index = i;
    deck.cards.forEach(({ node, head }, k) => {
      node.classList.toggle("selected", k === i && deck.cards.length > 1);
      head?.setAttribute("aria-pressed", String(k === i));
    });
    context.emit("selected", i);
  }

  for (const player of context.players) {
    player.on("change", () => deck.cards.filter((c) => c.player === player).forEach(update));
  }
  context.on("missions", build);
  return {
    get maps() {
      return deck.maps;
    },
    select: choose,
    selected: () => deck.index,
  };
}
