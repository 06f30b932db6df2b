// Flights by hand: the visitor's name and best score over this map, and the list of the map of the day.
import { ApiError } from "./api.js";
import { recall, remember } from "./base.js";
import { el, fact } from "./dom.js";
import { points } from "./format.js";

const NAME = "drone-env-name";
const BEST = "drone-env-best";
/** Maps whose best score is kept. */
const KEPT = 200;

/** The name that the visitor chose, or null. The server accepts no other form. */
export function nameOf() {
  const name = recall(NAME);
  return /^[\p{L}\p{N}_-]{1,20}$/u.test(name ?? "") ? name : null;
}

/** The visitor's best results: lists of map, score, optimum, pilot of the network and its score; oldest first. */
function results() {
  try {
    const stored = JSON.parse(recall(BEST));
    const valid = ([map, score, optimum]) => typeof map === "string" && Number.isFinite(score + optimum);
    return stored.filter((one) => Array.isArray(one) && valid(one));
  } catch {
    return [];
  }
}

export function mountByHand(root, { api, stage }, fleet, acts) {
  let today = null;
  let best = null;
  let drawn = "";
  const head = el("h2.eyebrow");
  const figures = el("dl.by-hand");
  const list = el("ol.best-today");
  const change = () => {
    field.value = field.value.trim();
    if (!field.reportValidity()) return;
    remember(NAME, field.value);
    if (fleet.mine?.steps === 0) acts.reset();
  };
  const field = el("input.input", {
    id: "name",
    maxlength: "20",
    pattern: "[\\p{L}\\p{N}_\\-]*",
    title: "Letters, digits, _ and -",
    autocomplete: "nickname",
    value: nameOf() ?? "",
    on: { change },
  });
  const label = el("label.eyebrow", { for: "name", text: "Your name" });
  root.append(head, figures, list, el("div.name-field", label, field));

  const map = () => `${stage.world.task.id} ${stage.world.seed}`;
  const isToday = () => today?.task === stage.world.task.short_name && today.seed === stage.world.seed;
  const byHand = () => fleet.shown && fleet.human >= 0;

  /** Keeps the result of a flight without values, undo and forks. */
  function keep({ annotation, unaided }) {
    if (!annotation || !unaided || best?.[1] >= annotation.score) return;
    best = [map(), annotation.score, annotation.optimal_score, annotation.network, annotation.network_score];
    const others = results().filter(([other]) => other !== best[0]);
    remember(BEST, JSON.stringify([...others, best].slice(-KEPT)));
  }

  function draw() {
    root.hidden = !stage.world || !(byHand() || best || isToday());
    if (root.hidden) return;
    const { track } = stage;
    if (byHand()) keep(fleet.tracks[fleet.human]);
    const day = isToday() ? new Date(today.date) : null;
    const written = { day: "numeric", month: "long", timeZone: "UTC" };
    const title = day ? `Map of the day, ${day.toLocaleDateString("en-GB", written)}` : "By hand";
    const { score, optimal_score: optimum, network, network_score } = track.annotation ?? {};
    const shown = [
      [track.name, score],
      ["Your best", best?.[1]],
      ["Possible", optimum ?? best?.[2]],
      [fleet.pilot(network ?? best?.[3]).name, network_score ?? best?.[4]],
      ["Best today", day && today.best[0]?.score],
    ];
    const now = JSON.stringify([title, shown, day && today.best]);
    if (now === drawn) return;
    drawn = now;
    head.textContent = title;
    figures.replaceChildren(...shown.filter(([, value]) => Number.isFinite(value)).map(([name, value]) => fact(name, points(value))));
    list.replaceChildren(...(day ? today.best : []).map(row));
  }

  const row = ({ name, score, steps }) => el("li", el("span", { text: name ?? "A person" }), ` ${points(score)}, ${steps} steps`);

  async function ask() {
    if (!byHand()) return;
    try {
      today = await api.get("today");
      draw();
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
    }
  }

  stage.on("load", () => (best = results().find(([one]) => one === map()) ?? null));
  stage.on("change", draw);
  fleet.on("begun", ask);
  fleet.on("ended", ask);
  draw();
}
