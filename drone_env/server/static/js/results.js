// Mission Results: how it ended, efficiency, score beside the optimum, the analysis, and what comes next.
import { ApiError } from "./api.js";
import { announce, closeBeside, el, fact, setText } from "./dom.js";
import { fixed, outcome, percent, points, signed, title } from "./format.js";
import { recall, remember } from "./storage.js";

const COUNTDOWN_SECONDS = 8;
const LANDING_MILLISECONDS = 600;
const CYCLE = "drone-env-cycle";

/** @param {import("./context.js").Context} context @param {import("./fleet.js").Fleet} fleet */
export function mountResults(context, fleet) {
  const dialog = document.getElementById("results");
  let timer = 0;
  let landing = 0;
  let next = null;
  let nextButton = null;
  let countdown = null;
  let scores = null;

  context.on("ended", (index, episode) => {
    const { player } = context;
    clearTimeout(landing);
    // The drone lands first.
    landing = setTimeout(() => {
      if (context.view === "watch" && index === 0 && player.episode === episode) open(player, episode);
    }, LANDING_MILLISECONDS);
  });
  context.player.on("frames", () => {
    const { player } = context;
    if (!dialog.open || !player.episode) return;
    const known = scoreRow(player, player.episode);
    scores.replaceWith(known);
    scores = known;
  });
  context.on("missions", close);
  context.on("view", close);
  dialog.addEventListener("close", stop);
  for (const type of ["pointerdown", "keydown"]) dialog.addEventListener(type, stop);
  closeBeside(dialog);

  function close() {
    if (dialog.open) dialog.close();
  }

  function open(player, episode) {
    const { mission, last } = player;
    next = nextTask(context.families, fleet.task());
    nextButton = el("button.button.primary", {
      id: "next-level",
      text: `Next: ${title(next.short_name)}`,
      press: goOn,
    });
    countdown = el("p.note.countdown", { id: "countdown" });
    const analysis = el(
      "div.analysis",
      { "aria-busy": "true" },
      el("p.note", { text: "Analysing all flights of this task …" }),
    );
    const cycle = el("input", {
      type: "checkbox",
      id: "cycle",
      checked: recall(CYCLE) !== "off",
      on: { change: () => remember(CYCLE, cycle.checked ? "on" : "off") },
    });
    const headline = episode.success ? "Mission accomplished" : "Mission failed";
    scores = scoreRow(player, episode);
    dialog.replaceChildren(
      el(
        "div.results-head",
        { data: { success: String(episode.success) } },
        el("p.eyebrow", {
          text: `${title(mission.short_name)} · map ${mission.seed} · ${fleet.pilot(mission.pilot).name}`,
        }),
        el("h2", { id: "results-title", text: headline }),
        el("p.results-why", {
          text: `${outcome(last)}: ${last.deliveries_done} of ${mission.deliveries_total} parcels in ${last.step} steps.`,
        }),
      ),
      scores,
      efficiencyBar(last),
      analysis,
      el("label.switch", cycle, el("span", { text: "Go on to the next level by itself" })),
      el(
        "div.dialog-actions",
        nextButton,
        el("button.button", {
          text: "Fly again",
          press: () => fleet.start({}, { play: true }),
        }),
        el("button.button", {
          text: "Look at the flight",
          on: {
            click: () => {
              dialog.close();
              context.emit("explain", player);
            },
          },
        }),
        el("button.button.quiet", { text: "Close", press: () => dialog.close() }),
      ),
      countdown,
    );
    if (!dialog.open) dialog.showModal();
    nextButton.focus({ preventScroll: true });
    announce(`${headline}. Score ${points(episode.score)}, efficiency ${fixed(last.efficiency, 1)}.`);
    analyse(context, mission, analysis);
    if (cycle.checked) count(COUNTDOWN_SECONDS);
  }

  function count(seconds) {
    setText(countdown, `Goes on in ${seconds} s. Any key or click here stops that.`);
    if (seconds === 0) goOn();
    else timer = setTimeout(() => count(seconds - 1), 1000);
  }

  function stop() {
    clearTimeout(timer);
    if (countdown) setText(countdown, "");
  }

  function goOn() {
    stop();
    dialog.close();
    const able = fleet.setup.pilots.filter((id) => fleet.flies(id, next));
    fleet.start({ task: next.short_name, seed: null, pilots: able.length ? able : fleet.setup.pilots }, { play: true });
  }
}

/** Easy, Medium, Hard, Easy; every family goes round. */
function nextTask(families, task) {
  const group = families.get(task.family);
  return group[(group.indexOf(task) + 1) % group.length];
}

/** The optimum comes with the episode, or after it, with the values. */
function scoreRow({ frames, last }, episode) {
  const number = (name, text, id, note) =>
    el(
      "div.result-number",
      el("dt", { text: name }),
      el("dd", { id, text }),
      note ? el("dd.result-note", { text: note }) : null,
    );
  const optimum = episode.optimal_score ?? frames[0].value;
  const regret = episode.regret ?? last.regret;
  return el(
    "dl.result-numbers",
    number("Efficiency", fixed(last.efficiency, 1), "result-efficiency", "of 100"),
    number(
      "Score",
      points(episode.score),
      "result-score",
      optimum === null ? "optimum not known" : `optimum ${points(optimum)}`,
    ),
    number("Given away", points(regret), "result-regret", regret === 0 ? "a perfect flight" : "of the score"),
  );
}

/** Three parts as wide as their weights, each filled by what is left or done. */
function efficiencyBar({ efficiency_parts: parts }) {
  return el(
    "div.efficiency",
    { "aria-label": "Efficiency", role: "group" },
    ...parts.map(({ name, weight, share }) =>
      el(
        "div.efficiency-part",
        { style: { "--weight": String(weight), "--share": String(share) } },
        el("div.efficiency-bar", { "aria-hidden": "true" }, el("i")),
        el("span.efficiency-name", { text: title(name) }),
        el("span.efficiency-share", { text: `${percent(share)} · weighs ${weight} %` }),
      ),
    ),
  );
}

/** Fills `root` with what all finished flights of the flight's task come to. @param {HTMLElement} root */
async function analyse({ api }, mission, root) {
  try {
    const a = await api.get(`analyse/${encodeURIComponent(mission.task)}`);
    root.replaceChildren(
      el("h3", { text: `${howMany(a.episodes)} of ${title(mission.short_name)} here` }),
      el(
        "dl.numbers",
        ...[
          ["Success rate", percent(a.success_rate)],
          ["Success trend", a.success_trend === null ? "–" : `${signed(a.success_trend * 100, 0)} %`],
          ["Mean score", points(a.average_score)],
          ["Mean reward", fixed(a.average_reward, 2)],
          ["Mean steps", fixed(a.average_steps, 1)],
          ["Mean given away", points(a.mean_regret)],
        ].map(([name, text]) => fact(name, text)),
      ),
      actionBar(a.action_distribution),
    );
  } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    root.replaceChildren(el("p.note", { text: `The analysis is not to be had: ${error.message}` }));
  }
  root.removeAttribute("aria-busy");
}

const howMany = (flights) => (flights === 1 ? "The only flight" : `All ${flights} flights`);

function actionBar(distribution) {
  const parts = Object.entries(distribution);
  return el(
    "div.actions-bar",
    ...parts.map(([action, share]) =>
      el(
        "div.action-part",
        { style: { "--share": String(share) } },
        el("i", { "aria-hidden": "true" }),
        el("span", { text: `${action} ` }),
        el("span", { text: percent(share) }),
      ),
    ),
  );
}
