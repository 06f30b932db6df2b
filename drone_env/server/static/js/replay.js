// Replay: a stored episode, or a file dropped on the page, flown again by the server and annotated move by move.
import { announce, copyLink, download, el, fact } from "./dom.js";
import { readFlights } from "./flight_file.js";
import { fixed, outcome, points, title } from "./format.js";
import { taken } from "./keys.js";
import { CityMap } from "./map.js";
import { mountMoves } from "./moves.js";
import { Player } from "./player.js";
import { Transport } from "./transport.js";

/** @param {HTMLElement} root An empty section. @param {import("./context.js").Context} context */
export function mount(root, context) {
  const replay = new Replay(root, context);
  context.on("view", () => replay.follow(context.router.address));
  listenToDrops(context, (file) => replay.openFile(file));
  document.addEventListener("keydown", (event) => {
    if (context.view !== "replay" || replay.player.empty || document.querySelector("dialog[open]")) return;
    if (event.ctrlKey || event.metaKey || event.altKey || taken(event)) return;
    if (replay.transport.press(event.key)) event.preventDefault();
  });
}

class Replay {
  constructor(root, context) {
    this.context = context;
    this.player = new Player();
    this.record = null;
    /** Id of the stored episode that is shown or on its way; null for none, or a file. */
    this.episode = null;
    this.asked = 0;

    const input = el("input.visually-hidden", {
      type: "file",
      id: "replay-file",
      accept: ".json,.jsonl",
      on: {
        change: () => {
          if (input.files[0]) this.openFile(input.files[0]);
          input.value = "";
        },
      },
    });
    const choose = el("label.button.file-button", { for: "replay-file", text: "Open a file…" });
    this.problem = el("p.problem", { role: "alert", hidden: true });
    this.status = el("p.note", { role: "status" });
    this.flights = el("select", {
      id: "replay-flight",
      on: { change: () => this.openRecord(this.choices[this.flights.selectedIndex]) },
    });
    this.chooser = el(
      "label.chooser",
      { for: "replay-flight", hidden: true },
      el("span", { text: "Flight" }),
      this.flights,
    );
    this.empty = el(
      "div.replay-empty",
      el("p", { text: "Nothing is replayed yet." }),
      el(
        "p.note",
        "Choose an episode in the ",
        el("a", { href: "?view=history", text: "history" }),
        ", or drop a file of flights here: what ",
        el("code", { text: "drone-env fly --record" }),
        " writes, as .json, or .jsonl with one flight per line.",
      ),
    );

    const mapRoot = el("div.replay-map");
    const moves = el("div.replay-moves");
    this.transport = new Transport(this.player);
    this.summary = new ReplaySummary();
    this.ghost = el("input", { type: "checkbox", checked: true, on: { change: () => this.drawGhost() } });
    const action = (text, press) => el("button.button.small", { text, press });
    this.link = action("Copy link", () => copyLink(location.href));
    this.body = el(
      "div.replay-body",
      { hidden: true },
      el("div.replay-stage", mapRoot, this.transport.root),
      el(
        "aside.replay-side",
        { "aria-label": "The flight" },
        this.summary.root,
        el("label.switch", this.ghost, "Show a best flight as a ghost"),
        moves,
        el(
          "div.replay-actions",
          action("Download record", () => this.downloadRecord()),
          this.link,
        ),
      ),
    );
    root.append(
      el("div.view-head", el("h2", { text: "Replay" }), el("div.filters", this.chooser, el("div", input, choose))),
      this.problem,
      this.empty,
      this.body,
      this.status,
    );
    this.map = new CityMap(mapRoot, this.player, context);
    mountMoves(moves, this.player);
  }

  /** Shows what the address says. */
  follow({ view, episode }) {
    if (view !== "replay" || episode === this.episode) return;
    this.episode = episode;
    if (episode) this.openEpisode(episode);
    else this.close();
  }

  /** Shows nothing. */
  close() {
    this.asked += 1;
    this.player.clear();
    this.empty.hidden = false;
    this.body.hidden = this.chooser.hidden = this.problem.hidden = true;
    this.status.textContent = "";
  }

  /** A stored episode. */
  async openEpisode(id) {
    await this.attempt(async (current) => {
      const record = await this.context.api.get(`episodes/${encodeURIComponent(id)}`);
      if (!current()) return;
      this.offer([record]);
      await this.show(record, current);
    });
  }

  /** A file; several flights in it are offered in a list, and the first is shown. */
  async openFile(file) {
    // A file has no address of its own.
    this.context.router.go({ view: "replay" });
    await this.attempt(async (current) => {
      const records = await readFlights(file);
      if (!current()) return;
      this.offer(records);
      await this.show(records[0], current);
    });
  }

  async openRecord(record) {
    await this.attempt((current) => this.show(record, current));
  }

  /** Does something that can fail and be overtaken by the next, and says what is wrong. */
  async attempt(act) {
    const asked = ++this.asked;
    const current = () => asked === this.asked;
    this.problem.hidden = true;
    this.status.textContent = "Flying it again …";
    try {
      await act(current);
    } catch (error) {
      if (!current()) return;
      this.problem.textContent = error.message;
      this.problem.hidden = false;
    }
    if (current()) this.status.textContent = "";
  }

  offer(records) {
    this.choices = records;
    this.chooser.hidden = records.length < 2;
    this.flights.replaceChildren(...records.map((record, i) => el("option", { text: `${i + 1}. ${named(record)}` })));
  }

  async show(record, current) {
    const { api } = this.context;
    const { opening: mission, frames } = await api.post("replay", record);
    if (!current()) return;
    this.record = record;
    this.link.hidden = this.episode === null;
    this.empty.hidden = true;
    this.body.hidden = false;
    this.player.load(mission, frames);
    this.summary.show(mission, frames.at(-1));
    this.drawGhost();
    announce(`Replay of ${named(record)}, ${frames.length - 1} steps.`);
    if (!record.ended) {
      this.summary.unknown("This flight did not end, so its moves are not annotated.");
      return;
    }
    this.status.textContent = "Looking at every move …";
    try {
      const annotation = await api.post("annotate", record);
      if (!current()) return;
      this.player.annotate(annotation);
      this.summary.annotated(annotation);
      this.drawGhost();
    } catch (error) {
      if (current()) this.summary.unknown(`The moves could not be annotated: ${error.message}`);
    }
  }

  drawGhost() {
    this.map.show({ ghost: this.ghost.checked ? (this.player.annotation?.optimal_path ?? null) : null });
  }

  downloadRecord() {
    const { task, seed, agent } = this.record;
    const name = `${task}-${seed}-${agent}`.replace(/[^\w.-]+/g, "_").slice(0, 100);
    download(`${name}.json`, new Blob([`${JSON.stringify(this.record, null, 2)}\n`], { type: "application/json" }));
  }
}

/** What a replayed flight came to, beside the optimum of its map. */
class ReplaySummary {
  constructor() {
    this.title = el("h3.replay-title");
    this.facts = el("dl.facts");
    this.verdict = el("div.verdict", { id: "replay-verdict" });
    this.root = el("div.replay-summary", this.title, this.facts, this.verdict);
  }

  /** @param {object} mission @param {object} last The last frame. */
  show(mission, last) {
    this.title.textContent = `${title(mission.task)}, map ${mission.seed}, flown by ${mission.pilot}`;
    this.facts.replaceChildren(
      fact("Outcome", outcome(last)),
      fact("Parcels", `${last.deliveries_done} of ${mission.deliveries_total}`),
      fact("Steps", `${last.step} of ${mission.max_steps}`),
      fact("Score", points(last.score)),
      fact("Efficiency", fixed(last.efficiency, 1)),
    );
    this.verdict.replaceChildren();
  }

  /** @param {object} annotation As `POST /annotate` tells it. */
  annotated(annotation) {
    this.facts.append(
      fact("Optimum", `${points(annotation.optimal_score)} in ${annotation.optimal_steps} steps`),
      fact("Regret", points(annotation.regret)),
    );
  }

  unknown(why) {
    this.verdict.replaceChildren(el("p.note", { text: why }));
  }
}

const named = ({ task, seed, agent }) => `${title(String(task))}, map ${seed}, ${agent}`;

/** A file may be dropped anywhere on the page. */
function listenToDrops(context, open) {
  const hint = el("div.drop-hint", { hidden: true }, el("p", { text: "Drop the file to replay its flights" }));
  document.body.append(hint);
  const hasFiles = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");
  document.addEventListener("dragover", (event) => {
    if (!hasFiles(event)) return;
    event.preventDefault();
    hint.hidden = false;
  });
  document.addEventListener("dragleave", (event) => {
    if (event.relatedTarget === null) hint.hidden = true;
  });
  document.addEventListener("drop", (event) => {
    hint.hidden = true;
    if (!hasFiles(event)) return;
    event.preventDefault();
    if (event.dataTransfer.files[0]) open(event.dataTransfer.files[0]);
  });
}
