// Flights by hand: the visitor's name and best score over this map, and the list of the map of the day.
import { recall, remember } from "./base.js";
import { copyText, el, fact, toast } from "./dom.js";
import { counted, percent, points } from "./format.js";
import { linkOf } from "./router.js";

const NAME = "drone-env-name";
const BEST = "drone-env-best";
/** Maps whose best score is kept. */
const KEPT = 1000;
const SHOWN = 7;
const BLOCKS = "▁▂▃▄▅▆▇█";
/** @param {Date} day */
const dayOf = (day) => day.toLocaleDateString("en-GB", { day: "numeric", month: "long", timeZone: "UTC" });

/** The name that the visitor chose, or null. The server accepts no other form. */
export const nameOf = () => recall(NAME)?.match(/^[\p{L}\p{N}_-]{1,20}$/u)?.[0] ?? null;

/** The visitor's best results: lists of map, score and optimum; oldest first. */
function results() {
  try {
    return JSON.parse(recall(BEST)).filter(([map, score]) => typeof map === "string" && score <= 1);
  } catch {
    return [];
  }
}

/** The map of the day some days ago, and the visitor's share of its optimum, or null. The number of the map is the date. */
function daily(ago) {
  const { task, seed, tasks } = document.getElementById("today").dataset;
  const all = tasks.split(" ");
  const day = new Date(Date.UTC(Number(seed.slice(0, 4)), Number(seed.slice(4, 6)) - 1, Number(seed.slice(6)) - ago));
  const map = `${all.at((all.indexOf(task) - ago) % all.length)} ${day.toISOString().slice(0, 10).replaceAll("-", "")}`;
  const [, score, optimum] = results().find(([one]) => one === map) ?? [];
  const share = score === undefined ? null : score / (optimum ?? 1);
  const said = `${dayOf(day)}: ${share === null ? "not flown" : `${percent(share)} of the optimum`}`;
  return { share, said, block: share === null ? "·" : BLOCKS[Math.floor(share * (BLOCKS.length - 1))] };
}

/** The visitor's last maps of the day, how many in a row, and a text to share that contains no move. */
function ownDays() {
  const days = Array.from({ length: SHOWN }, (_, ago) => daily(ago)).reverse();
  if (days.every(({ share }) => share === null)) return [];
  // A map of today that is not flown yet does not end the row.
  const first = daily(0).share === null ? 1 : 0;
  let ago = first;
  while (daily(ago).share !== null) ago++;
  const row = `${counted(ago - first, "day")} in a row`;
  const blocks = days.map(({ block }) => block).join("");
  const { task, seed } = document.getElementById("today").dataset;
  const link = linkOf({ task, seed: Number(seed), pilots: ["human"] }).href;
  const text = [`Drone Delivery, ${days.at(-1).said}, ${row}`, blocks, link].join("\n");
  const label = `Your maps of the day. ${days.map(({ said }) => said).join(", ")}`;
  return [
    el("span.blocks", { role: "img", "aria-label": label, title: label, text: blocks }),
    el("span", { text: row }),
    first ? "" : el("button.button.small", { text: "Copy result", press: () => copyText(text, "Copied, without your moves.") }),
  ];
}

/** @param {HTMLElement} root @param {Context} context @param {Race} race */
export function mountByHand(root, context, race, acts) {
  const { api, stage } = context;
  let [today, best, drawn, request] = [null, null, "", 0];
  const [head, figures, record, unlisted, list] = root.querySelectorAll("h2, dl, .own-days, #unlisted, ol");
  const refused = root.querySelector("#refused-name");
  const field = root.querySelector("input");
  field.value = nameOf() ?? "";
  field.addEventListener("change", rename);

  const map = () => `${stage.world.task.id} ${stage.world.seed}`;

  function rename() {
    field.value = field.value.trim();
    const fits = field.checkValidity();
    refused.hidden = fits;
    // An invalid name is no name, rather than the one before.
    remember(NAME, field.value);
    // A refused one stays in sight, to be corrected.
    if (fits) field.blur();
    if (race.mine?.steps === 0) acts.reset();
    else if (fits) toast("Used from your next flight on.");
    if (!fits) refused.scrollIntoView({ block: "nearest" });
  }

  /** Keeps the result of a flight without values, undo and forks. */
  function keep({ annotation, plain, brought }) {
    if (!annotation || brought || !plain || best?.[1] >= annotation.score) return;
    best = [map(), annotation.score, annotation.optimum?.score ?? null];
    remember(BEST, JSON.stringify([...results().filter(([other]) => other !== best[0]), best].slice(-KEPT)));
  }

  function draw() {
    const { world, track } = stage;
    const day = world && today?.task === world.task.short_name && today.seed === world.seed ? today : null;
    root.hidden = !day && !best && !race.own;
    if (root.hidden) return;
    if (race.own) keep(race.own);
    unlisted.hidden = !race.own || race.own.plain;
    const title = day ? `Map of the day, ${dayOf(new Date(day.date))}` : "By hand";
    const shown = [
      [race.own?.name, race.own?.annotation?.score],
      ["Your best", best?.[1]],
      ["Possible", track.annotation?.optimum?.score ?? best?.[2]],
      ["Best today", day?.best[0]?.score],
    ];
    const now = JSON.stringify([title, shown, day?.best]);
    if (now === drawn) return;
    drawn = now;
    // A visitor who has flown the map may open the flights of others.
    const look = (id, text) => (best ? el("a", { href: `?episode=${id}`, text }) : text);
    const row = ({ id, person, score, steps }) => el("li", look(id, person ?? "A person"), ` ${points(score)}, ${steps} steps`);
    head.textContent = title;
    record.replaceChildren(...(day ? ownDays() : []));
    figures.replaceChildren(...shown.filter(([, value]) => Number.isFinite(value)).map(([name, value]) => fact(name, points(value))));
    list.replaceChildren(...(day?.best ?? []).map(row));
  }

  /** Without an answer, the page shows the list that it has. */
  async function ask() {
    if (!race.own) return;
    const mine = ++request;
    const answer = await api.get("today").catch(() => null);
    // An answer that a later one has overtaken is old.
    if (mine !== request) return;
    today = answer ?? today;
    draw();
  }

  stage.on("load", () => {
    best = results().find(([one]) => one === map()) ?? null;
    document.getElementById("own-days").replaceChildren(...ownDays());
  });
  stage.on("change", draw);
  for (const event of ["begun", "ended"]) race.on(event, ask);
}
