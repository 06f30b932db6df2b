// The ranking of the flights over the map.
import { el, keepFocus, setText } from "./dom.js";
import { lossOf, points } from "./format.js";

/** @param {HTMLElement} root @param {Context} context */
export function mountStandings(root, { stage }) {
  root.append(document.getElementById("race").content);
  const body = root.querySelector("tbody");
  const note = root.querySelector("p");
  let rows = [];

  function build() {
    rows = stage.tracks.map((track, i) => {
      const cells = Array.from({ length: 4 }, () => el("td.num"));
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
    setText(note, placeOf(stage) || "Ranked by score.");
  }

  stage.on("load", build);
  stage.on("change", draw);
}

/** The result of the selected flight among others, which does not depend on the moment; empty before the end. @param {import("./stage.js").Stage} stage */
export function placeOf({ over, tracks, track }) {
  if (!over || tracks.length < 2) return "";
  const sorted = tracks.toSorted((a, b) => b.last.score - a.last.score);
  const place = 1 + sorted.findIndex(({ last }) => last.score === track.last.score);
  const all = sorted.map(({ name, last }) => `${name} ${points(last.score)}`).join(", ");
  return `At the end, place ${place} of ${tracks.length}: ${all}. The higher score wins.`;
}
