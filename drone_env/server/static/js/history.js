// Finished flights from the store or from a file: the server replays and annotates them.
import { tried } from "./api.js";
import { recall, remember } from "./base.js";
import { download, el } from "./dom.js";
import { counted, flightName, sentence } from "./format.js";
import { FLOWN } from "./race.js";
import { worldOf } from "./stage.js";
import { Track } from "./track.js";

/** What is shown: the id of a stored flight, or a file as addresses name it; all its records, and the flight on the stage. */
const NONE = { episode: null, file: null, records: [], tracks: null };

export class FlightHistory {
  /** @param {Context} context */
  constructor(context) {
    this.context = context;
    this.request = 0;
    this.shown = NONE;
    const { stage } = context;
    stage.on("load", () => {
      if (stage.tracks === this.shown.tracks) return;
      this.request += 1;
      this.shown = NONE;
    });
  }

  /** The selected flight of a file, as addresses write it; null for the first. @returns {Partial<Address>} */
  get linkParts() {
    const at = this.shown.records.indexOf(this.context.stage.track?.record);
    return { selected: at > 0 ? at + 1 : null };
  }

  /** Whether the flights of an address are shown. @param {Address} address */
  shows({ episode, file, fork }) {
    if (file) return file === this.shown.file;
    return episode !== null && fork === null && episode === this.shown.episode;
  }

  /** Shows the flight of an address. @param {Address} address @throws {ApiError} */
  async open({ episode, file, selected, step }) {
    if (file) return this.openRecord(file, (selected ?? 1) - 1, step);
    const request = ++this.request;
    const track = await this.stored(episode);
    if (request !== this.request) return;
    this.show(track, { step, episode });
    this.askForCalls(track);
  }

  async stored(id) {
    const { api, pilot } = this.context;
    const record = await api.get(`episodes/${encodeURIComponent(id)}`);
    const track = await this.flown(record);
    track.episode = { id };
    if ((recall(FLOWN) ?? "").split(" ").includes(id)) track.called = pilot(track.pilot).name;
    return track;
  }

  async openRecord(file, index, step) {
    const request = ++this.request;
    const name = nameOf(file);
    const records = JSON.parse(recall(`${FLIGHTS} ${file}`, "sessionStorage"));
    if (!records) throw new Error(goneFrom(file));
    if (index >= records.length) throw new Error(`${name} contains ${counted(records.length, "flight")}, none with number ${index + 1}.`);
    const track = await this.flown(records[index]).catch((error) => {
      if (error.code !== "invalid_request") throw error;
      throw new Error(`${name} is not a flight file. ${sentence(error.message.replace(/\bbody(\.|: )/g, ""))}.`);
    });
    if (request === this.request) this.show(track, { step, file, records });
  }

  async flown(record) {
    await this.context.meet(record?.task);
    const flown = await this.context.api.post("replay", record);
    const track = new Track(this.context, flown);
    track.record = record;
    return track;
  }

  /** Shows the end unless a step is named: the results are beside it. */
  show(track, { step = null, episode = null, file = null, records = [] }) {
    const { stage, tasks } = this.context;
    this.shown = { episode, file, records, tracks: [track] };
    stage.show(worldOf(track.opening, tasks), this.shown.tracks, { step: step ?? Infinity });
    explain(this.context, track);
  }

  /** Loads the prompts and answers of a language model. */
  async askForCalls(track) {
    if (track.ours) return;
    const answer = await tried(() => this.context.api.get(`episodes/${encodeURIComponent(track.episode.id)}/calls`));
    if (!answer?.calls.length) return;
    const steps = new Map();
    for (const call of answer.calls) steps.set(call.turn, [...(steps.get(call.turn) ?? []), call]);
    track.calls = { model: answer.model, steps };
    this.context.stage.changed(track);
  }
}

async function recordOf({ api }, track) {
  track.record ??= await api.get(`episodes/${encodeURIComponent(track.episode.id)}`);
  return track.record;
}

/** Annotates a finished flight: the loss of each move. @param {Context} context */
export async function explain(context, track) {
  if (track.annotation || !track.done) return;
  try {
    track.annotation = await context.api.post("annotate", await recordOf(context, track));
  } catch (error) {
    track.unexplained = error.message;
    context.stage.changed(track);
    return;
  }
  const { annotation } = track;
  annotation.moves.forEach(({ value }, i) => Object.assign(track.frames[i], lost(value, annotation)));
  Object.assign(track.last, lost(annotation.score, annotation));
  context.stage.changed(track);
}

const lost = (value, { optimum }) => ({ value, regret: optimum && Math.max(0, optimum.score - value) });

/** Where this tab keeps the flights of a file, and the map of one. */
const FLIGHTS = "drone-env-flights";
export const MAP = "drone-env-map";
/** The name of an opened file, as an address names it. */
const nameOf = (file) => file.replace(/~\w*$/, "");
export const goneFrom = (file) => `This tab does not have ${nameOf(file)} any more. Open the file again.`;

const ENDINGS = [".json", ".jsonl", ".toml"];

/** The field that opens a file of flights in Fly, or of a map in Draw, and its button. @param {Context} context */
export function openField({ api, router }, id, wrong) {
  const input = el("input.visually-hidden", { type: "file", id, accept: ENDINGS.join(), on: { change } });
  async function change() {
    const [file] = input.files;
    try {
      const text = await file.text();
      const isMap = file.name.toLowerCase().endsWith(".toml");
      const content = isMap ? await api.post("maps/file", { toml: text }) : readFlights(file.name, text);
      // Every time a file is opened, it gets its own address. This tab can show it again.
      const name = `${file.name}~${Date.now().toString(36)}`;
      remember(`${isMap ? MAP : FLIGHTS} ${name}`, JSON.stringify(content), "sessionStorage");
      router.go({ view: isMap ? "draw" : "fly", file: name });
    } catch (error) {
      wrong(error.status === 422 ? `${file.name} is not a map. ${error.message}` : error.message);
    }
    input.value = "";
  }
  return [input, el("label.button.small", { for: id, text: "Open a file…" })];
}

/** The records of a file: one JSON document, or one per line. The server checks them. @returns {object[]} */
function readFlights(name, text) {
  if (!ENDINGS.some((ending) => name.toLowerCase().endsWith(ending))) {
    throw new Error(`${name} is neither flights nor a map: its name must end in ${ENDINGS.join(", ")}.`);
  }
  const whole = parsed(text);
  if (whole !== undefined) return [whole];
  return text.split("\n").flatMap((line, i) => {
    if (!line.trim()) return [];
    const record = parsed(line);
    if (["task", "seed", "agent"].every((field) => field in Object(record))) return [record];
    throw new Error(`${name}, line ${i + 1} is not a flight.`);
  });
}

function parsed(text) {
  try {
    return JSON.parse(text);
  } catch {
    return undefined;
  }
}

/** The button that saves the record of a finished flight. @param {HTMLElement} root @param {Context} context */
export function mountRecord(root, context) {
  const { stage } = context;
  async function press() {
    const { track, world } = stage;
    const record = await tried(() => recordOf(context, track));
    if (!record) return;
    const name = `${world.task.short_name}-${world.seed}-${record.agent}`.replace(/[^\w.-]+/g, "_").slice(0, 100);
    download(`${name}.json`, new Blob([`${JSON.stringify(record, null, 2)}\n`], { type: "application/json" }));
  }
  const save = el("button.button.quiet.small", { id: "save-record", text: "Save record", press });
  root.append(save);
  stage.on("change", () => (save.disabled = !stage.track?.record && !stage.track?.episode));
}

/** The file field, and the choice of a flight if the file contains several. */
export function mountFiles(root, history, problem) {
  const { router, stage } = history.context;
  const change = () => router.go({ file: history.shown.file, selected: flights.selectedIndex + 1 });
  const flights = el("select", { id: "flight-of-file", "aria-label": "Flight of the file", hidden: true, on: { change } });
  const [field, button] = openField(history.context, "flight-file", problem);
  // The open choices would cover the flights and the error.
  field.addEventListener("change", () => (root.closest("details").open = false));
  root.append(el("div.field", field, button, flights));

  let offered = history.shown.records;
  stage.on("change", () => {
    if (history.shown.records !== offered) {
      offered = history.shown.records;
      flights.hidden = offered.length < 2;
      flights.replaceChildren(...offered.map((record, i) => el("option", { text: `${i + 1}. ${flightName(history.context, record)}` })));
    }
    flights.selectedIndex = offered.indexOf(stage.track?.record);
  });
}
