// Each move from here: its value for the network, and the score that stays possible.
import { el, setText, table } from "./dom.js";
import { ARROWS, fixed, isLost, points } from "./format.js";

const COLUMNS = [["Move"], ["Network", true], ["Still possible", true], ["Loss", true]];

/** @param {HTMLElement} root @param {Context} context @param {Race} race */
export function mountThinking(root, { stage }, race, acts) {
  const rows = Object.keys(ARROWS).map((action) => {
    const cells = COLUMNS.slice(1).map(() => el("td.num"));
    const press = () => play(action);
    const name = el("button.q-move", { press, "aria-label": `Play ${action}` }, el("i", { text: ARROWS[action] }), action);
    return { action, cells, name, node: el("tr", { data: { action } }, el("th", { scope: "row" }, name), ...cells) };
  });
  const body = el("tbody", ...rows.map(({ node }) => node));
  const shown = table("table.table.thoughts", { id: "q-values" }, "Each move from here", COLUMNS, body);
  root.append(document.getElementById("thinking").content, shown);
  const ask = root.querySelector("button");
  ask.addEventListener("click", () => race.help());

  /** Plays a move: continues the visitor's own flight, or forks another one. */
  function play(action) {
    if (race.atHand) race.fly(action);
    else acts.fork({ action });
  }

  function draw() {
    const { track, frame, answer } = stage;
    root.hidden = !track;
    if (!track) return;
    const network = frame.q_values;
    shown.classList.toggle("unweighed", !track.weighed);
    const exact = frame.done ? null : (answer?.q_values ?? null);
    const best = exact && Math.max(...Object.values(exact));
    const first = network && Math.max(...Object.values(network));
    for (const { action, cells, name, node } of rows) {
      setText(cells[0], network ? fixed(network[action], 3) : "–");
      setText(cells[1], exact ? points(exact[action]) : "–");
      setText(cells[2], exact ? (isLost(best - exact[action]) ? points(best - exact[action]) : "0") : "–");
      cells[0].classList.toggle("best", network !== null && network[action] === first);
      node.classList.toggle("best", exact !== null && !isLost(best - exact[action]));
      name.disabled = frame.done;
    }
    ask.hidden = !track.secret;
  }

  stage.on("change", draw);
}
