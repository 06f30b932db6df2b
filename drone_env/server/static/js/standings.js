// Race: who leads, live; after the end the flight that is selected, move by move, and the best flight as a ghost.
import { el, setText, table } from "./dom.js";
import { outcome, points } from "./format.js";
import { nextFrame } from "./loop.js";
import { mountMoves } from "./moves.js";
import { mountRaceChart } from "./race_chart.js";

const NAMES = new Intl.ListFormat("en");

/**
 * @param {HTMLElement} root @param {import("./context.js").Context} context @param {import("./fleet.js").Fleet} fleet
 * @returns {HTMLCanvasElement} The chart of what has been given away.
 */
export function mountStandings(root, context, fleet) {
  const body = el("tbody");
  const columns = [["Pilot"], ["Steps", true], ["Parcels", true], ["Score", true], ["Given away", true]];
  const standings = table("table.table.standings", { id: "standings" }, "Standings", columns, body);
  const note = el("p.note", { id: "race-note" });
  const moves = el("div.race-moves");
  const chart = el("figure.race-chart");
  root.append(el("div.panel-head", el("h2.eyebrow", { text: "Standings" })), standings, note, chart, moves);
  const canvas = mountRaceChart(chart, context, fleet);
  let lists = [];
  let rows = [];
  let selected = 0;

  /** Not before the first race: who only watches needs none of them. */
  function mountLists() {
    lists = context.players.map((player) => {
      const node = el("div.race-list", { hidden: true });
      moves.append(node);
      return { node, drawMoves: mountMoves(node, player) };
    });
  }

  function build(players) {
    if (players.length > 1 && !lists.length) mountLists();
    rows = players.map((player, i) => {
      const cells = Array.from({ length: 4 }, () => el("td.num"));
      const name = el(
        "button.standing-name",
        { press: () => context.emit("select", i) },
        el("span", { text: fleet.pilot(player.mission.pilot).name }),
      );
      return {
        player,
        cells,
        node: el("tr", { style: { "--lane": `var(--lane-${i + 1})` } }, el("th", { scope: "row" }, name), ...cells),
        i,
      };
    });
    body.replaceChildren(...rows.map(({ node }) => node));
    draw();
  }

  function draw() {
    for (const { player, cells, node, i } of rows) {
      if (player.empty || !player.frame) continue;
      const { frame, mission } = player;
      setText(cells[0], String(frame.step));
      setText(cells[1], `${frame.deliveries_done}/${mission.deliveries_total}`);
      setText(cells[2], frame.done ? points(frame.score) : "–");
      setText(cells[3], points(frame.regret));
      node.dataset.outcome = frame.outcome;
      node.classList.toggle("selected", i === selected);
    }
    lists.forEach(({ node, drawMoves }, i) => {
      const hidden = i !== selected || !context.players[i].annotation;
      if (hidden === node.hidden) return;
      node.hidden = hidden;
      if (!hidden) drawMoves();
    });
    setText(note, words());
  }

  function words() {
    if (!fleet.active.length) return "";
    const optimum = fleet.active.map((player) => player.frames[0]?.value ?? null).find((value) => value !== null);
    const best = optimum === undefined ? "" : ` The optimum of this map is ${points(optimum)}.`;
    if (!fleet.over) return `Same map, same moment.${best}`;
    const top = Math.max(...fleet.active.map((player) => player.last.score));
    const winners = fleet.active.filter((player) => player.last.score === top);
    const names = NAMES.format(winners.map((player) => fleet.pilot(player.mission.pilot).name));
    const how = outcome(winners[0].last).toLowerCase();
    return `${names} ${winners.length > 1 ? "tie" : "wins"} with ${points(top)}: ${how}.${best}`;
  }

  context.on("missions", build);
  context.on("selected", (i) => {
    selected = i;
    draw();
  });
  for (const player of context.players) player.on("change", () => nextFrame(draw));
  return canvas;
}
