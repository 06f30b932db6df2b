// The ranking of the flights over the map.
import { el, setText, table } from "./dom.js";
import { outcome, points } from "./format.js";

const COLUMNS = [["Pilot"], ["Steps", true], ["Parcels", true], ["Possible", true], ["Lost", true]];

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
      const name = el("button.standing-name", { press: () => stage.select(i) }, el("span", { text: track.name }));
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
        points(frame.done ? frame.score : frame.value),
        points(frame.regret),
      ];
      texts.forEach((text, i) => setText(cells[i], text));
      node.dataset.outcome = frame.outcome;
      node.classList.toggle("selected", track === stage.track);
    }
    // Before the first step everything is possible; this is not a secret.
    const all = Math.max(...rows.map(({ track }) => track.valueAt(0) ?? track.frames[0].score));
    const rank = ({ track }) => possible(track.frameAt(cursor), all);
    const ranked = [...rows].sort((a, b) => rank(b) - rank(a));
    if (ranked.some(({ node }, i) => body.children[i] !== node)) {
      const focused = document.activeElement;
      body.replaceChildren(...ranked.map(({ node }) => node));
      if (focused instanceof HTMLElement && body.contains(focused)) focused.focus();
    }
    setText(note, describe());
  }

  function describe() {
    if (!stage.over) return "Ranked by the score still possible.";
    // The result, also while the page shows an earlier moment.
    const [first, second] = [...rows].sort((a, b) => b.track.last.score - a.track.last.score);
    const best = first.track.last.score;
    if (second.track.last.score === best) return `A tie with ${points(best)}.`;
    return `${first.track.name} wins with ${points(best)}: ${outcome(first.track.last).toLowerCase()}.`;
  }

  stage.on("load", build);
  stage.on("change", draw);
}

/** The score still possible, or the present score if it is hidden. @param {number} all The score possible at the start. */
function possible(frame, all) {
  if (frame.done) return frame.score;
  return frame.value ?? (frame.step ? frame.score : all);
}
