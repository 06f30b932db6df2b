// The ranking of the flights over the map.
import { el, keepFocus, setText, table } from "./dom.js";
import { lossOf, points } from "./format.js";

const COLUMNS = [["Pilot"], ["Steps", true], ["Parcels", true], ["Score", true], ["Lost", true]];

/** @param {HTMLElement} root @param {Context} context */
export function mountStandings(root, { stage }) {
  const body = el("tbody");
  const note = el("p.note", { id: "standings-note" });
  const shown = table("table.table.standings", { id: "standings" }, "Standings", COLUMNS, body);
  root.append(el("h2.eyebrow", { text: "Standings" }), shown, note);
  let rows = [];

  function build() {
    rows = stage.tracks.map((track, i) => {
      const cells = COLUMNS.slice(1).map(() => el("td.num"));
      const name = el("button.standing-name", { data: { key: i }, press: () => stage.select(i) }, el("span", { text: track.name }));
      const node = el("tr", { style: { "--lane": `var(${track.colour})` } }, el("th", { scope: "row" }, name), ...cells);
      return { track, cells, node };
    });
    root.hidden = rows.length < 2;
    draw();
  }

  function draw() {
    if (root.hidden) return;
    const { cursor } = stage.clock;
    for (const { track, cells, node } of rows) {
      const frame = track.frameAt(cursor);
      const texts = [
        String(frame.step),
        `${frame.deliveries_done}/${stage.world.parcels.length}`,
        frame.done ? points(frame.score) : frame.value === null ? points(null) : `up to ${points(frame.value)}`,
        lossOf(track, frame),
      ];
      texts.forEach((text, i) => setText(cells[i], text));
      node.dataset.outcome = frame.outcome;
      node.classList.toggle("selected", track === stage.track);
    }
    const rank = ({ track }) => track.frameAt(cursor).score;
    const ranked = rows.toSorted((a, b) => rank(b) - rank(a));
    if (ranked.some(({ node }, i) => body.children[i] !== node)) {
      keepFocus(body, () => body.replaceChildren(...ranked.map(({ node }) => node)));
    }
    const place = placeOf(stage);
    const result = cursor < stage.clock.end() && place ? `At the end: ${place}` : place;
    setText(note, result || "Ranked by score.");
  }

  stage.on("load", build);
  stage.on("change", draw);
}

const PLACES = ["1st", "2nd", "3rd"];

/** The result of the selected flight among others, which does not depend on the moment; empty before the end. @param {import("./stage.js").Stage} stage */
export function placeOf({ over, tracks, track }) {
  if (!over || tracks.length < 2) return "";
  const sorted = [...tracks].sort((a, b) => b.last.score - a.last.score);
  const scores = sorted.map(({ last }) => last.score);
  const place = scores.indexOf(track.last.score);
  const tie = place < scores.lastIndexOf(track.last.score) ? ", a tie" : "";
  const all = sorted.map(({ name, last }) => `${name} ${points(last.score)}`).join(", ");
  return `${PLACES[place] ?? `${place + 1}th`} of ${tracks.length}${tie}: ${all}. The higher score wins.`;
}
