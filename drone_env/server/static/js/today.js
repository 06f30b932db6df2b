// Flights by hand: the visitor's name and best score over this map, and the list of the map of the day.
import { recall, remember } from "./base.js";
import { el, fact, setText, toast } from "./dom.js";
import { points } from "./format.js";

const NAME = "drone-env-name";
const BEST = "drone-env-best";
export const UNLISTED = "Flights with Undo, values or a fork are not listed and not kept as your best.";
const ABOUT = "Shown to all in the list of the map of the day.";
const REFUSED = "Use at most 20 letters, digits, _ and -, without spaces. Your next flight has no name.";
/** Maps whose best score is kept. */
const KEPT = 200;
/** @type {Intl.DateTimeFormatOptions} */
const DAY = { day: "numeric", month: "long", timeZone: "UTC" };

/** The name that the visitor chose, or null. The server accepts no other form. */
export const nameOf = () => recall(NAME)?.match(/^[\p{L}\p{N}_-]{1,20}$/u)?.[0] ?? null;

/** The visitor's best results: lists of map, score, optimum, pilot of the network and its score; oldest first. */
function results() {
  try {
    return JSON.parse(recall(BEST)).filter(([map, score]) => typeof map === "string" && score <= 1);
  } catch {
    return [];
  }
}

export function mountByHand(root, context, race, acts) {
  const { api, stage } = context;
  let [today, best, drawn] = [null, null, ""];
  const head = el("h2.eyebrow");
  const figures = el("dl.by-hand");
  const list = el("ol.best-today");
  const field = el("input.input", {
    id: "name",
    pattern: "[\\p{L}\\p{N}_\\-]{0,20}",
    "aria-describedby": "about-name",
    autocomplete: "nickname",
    value: nameOf() ?? "",
    on: { change: rename },
  });
  const unlisted = el("p.note", { id: "unlisted", text: UNLISTED });
  const about = el("p.note", { id: "about-name", role: "alert", text: ABOUT });
  root.append(head, figures, unlisted, list, el("label.name-field.eyebrow", "Your name", field), about);

  const map = () => `${stage.world.task.id} ${stage.world.seed}`;

  function rename() {
    field.value = field.value.trim();
    const fits = field.checkValidity();
    setText(about, fits ? ABOUT : REFUSED);
    // An invalid name is no name, rather than the one before.
    remember(NAME, field.value);
    // A refused one stays in sight, to be corrected.
    if (fits) field.blur();
    if (race.mine?.steps === 0) acts.reset();
    else if (fits) toast("Used from your next flight on.");
    if (!fits) about.scrollIntoView({ block: "nearest" });
  }

  /** Keeps the result of a flight without values, undo and forks. */
  function keep({ annotation, plain, brought }) {
    if (!annotation || brought || !plain || best?.[1] >= annotation.score) return;
    best = [map(), annotation.score, annotation.optimal_score, annotation.network, annotation.network_score];
    remember(BEST, JSON.stringify([...results().filter(([other]) => other !== best[0]), best].slice(-KEPT)));
  }

  function draw() {
    const { world, track } = stage;
    const day = world && today?.task === world.task.short_name && today.seed === world.seed ? today : null;
    root.hidden = !day && !best && !race.own;
    if (root.hidden) return;
    if (race.own) keep(race.own);
    unlisted.hidden = !race.own || race.own.plain;
    const { optimal_score: optimum, network, network_score } = track.annotation ?? {};
    const title = day ? `Map of the day, ${new Date(day.date).toLocaleDateString("en-GB", DAY)}` : "By hand";
    const shown = [
      [race.own?.name, race.own?.annotation?.score],
      ["Your best", best?.[1]],
      ["Possible", optimum ?? best?.[2]],
      [context.pilot(network ?? best?.[3]).name, network_score ?? best?.[4]],
      ["Best today", day?.best[0]?.score],
    ];
    const now = JSON.stringify([title, shown, day?.best]);
    if (now === drawn) return;
    drawn = now;
    // A visitor who has flown the map may open the flights of others.
    const look = (id, text) => (best ? el("a", { href: `?episode=${id}`, text }) : text);
    const row = ({ id, name, score, steps }) => el("li", look(id, name ?? "A person"), ` ${points(score)}, ${steps} steps`);
    head.textContent = title;
    figures.replaceChildren(...shown.filter(([, value]) => Number.isFinite(value)).map(([name, value]) => fact(name, points(value))));
    list.replaceChildren(...(day?.best ?? []).map(row));
  }

  /** Without an answer, the page shows the list that it has. */
  async function ask() {
    if (!race.own) return;
    today = await api.get("today").catch(() => today);
    draw();
  }

  stage.on("load", () => (best = results().find(([one]) => one === map()) ?? null));
  stage.on("change", draw);
  for (const event of ["begun", "ended"]) race.on(event, ask);
}
