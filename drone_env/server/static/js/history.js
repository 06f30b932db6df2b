// Finished flights from the store or from a file: the server replays and annotates them.
import { tried } from "./api.js";
import { download, el, fileField } from "./dom.js";
import { flightName, sentence } from "./format.js";
import { worldOf } from "./stage.js";
import { Track } from "./track.js";

export class FlightHistory {
  /** @param {Context} context */
  constructor(context) {
    this.context = context;
    /** Id of the stored flight that is shown, or null. */
    this.episode = null;
    /** The records of the opened file, one of which is shown. */
    this.records = [];
    this.request = 0;
    /** The flights that are shown, as the stage has them. @type {Track[]|null} */
    this.tracks = null;
    const { stage } = context;
    stage.on("load", () => stage.tracks === this.tracks || this.leave());
  }

  /** Shows a stored flight. @throws {ApiError} */
  async open(id, step) {
    const request = ++this.request;
    const track = await this.stored(id);
    if (request !== this.request) return;
    this.show([track], { step, episode: id });
    this.askForCalls(track);
  }

  async stored(id) {
    const { api } = this.context;
    const record = await api.get(`episodes/${encodeURIComponent(id)}`);
    const track = await this.flown(record);
    track.episode = { id };
    return track;
  }

  async openFile(file) {
    const request = ++this.request;
    const records = await readFlights(file);
    if (request !== this.request) return;
    await this.openRecord(0, records).catch((error) => {
      if (error.code !== "invalid_request") throw error;
      throw new Error(`${file.name} is not a flight file. ${sentence(error.message.replace(/\bbody(\.|: )/g, ""))}.`);
    });
  }

  /** Shows a flight of the file, beside the others over the same map: as many as may fly together. */
  async openRecord(index, records = this.records) {
    const request = ++this.request;
    const { most } = this.context;
    const mapOf = (record) => String([record?.task, record?.seed, record?.reward_profile]);
    const all = records.filter((record) => mapOf(record) === mapOf(records[index]));
    const at = all.indexOf(records[index]);
    const first = at - (at % most);
    const tracks = await Promise.all(all.slice(first, first + most).map((record) => this.flown(record)));
    if (request !== this.request) return;
    const named = (track) => tracks.filter(({ called }) => called === track.called).length > 1;
    tracks.filter(named).forEach((track) => (track.called += ` (${records.indexOf(track.record) + 1})`));
    this.show(tracks, { selected: at - first, records });
  }

  leave() {
    this.request += 1;
    this.episode = this.tracks = null;
    this.records = [];
  }

  async flown(record) {
    await this.context.meet(record?.task);
    const flown = await this.context.api.post("replay", record);
    const track = new Track(this.context, flown);
    track.record = record;
    return track;
  }

  /** Shows the end unless a step is named: the results are beside it. */
  show(tracks, { step = null, selected = 0, episode = null, records = [] }) {
    const { stage, tasks } = this.context;
    Object.assign(this, { tracks, episode, records });
    stage.show(worldOf(tracks[0].opening, tasks), tracks, { step: step ?? Infinity, selected });
    for (const track of tracks) explain(this.context, track);
  }

  /** Loads the prompts and answers of a language model. */
  async askForCalls(track) {
    if (track.ours) return;
    const answer = await tried(() => this.context.api.get(`episodes/${encodeURIComponent(track.episode.id)}/calls`));
    if (!answer?.calls.length) return;
    const steps = new Map();
    for (const call of answer.calls) steps.set(call.step, [...(steps.get(call.step) ?? []), call]);
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
  const annotation = await tried(async () => context.api.post("annotate", await recordOf(context, track)));
  if (!annotation) return;
  track.annotation = annotation;
  annotation.moves.forEach(({ value }, i) => Object.assign(track.frames[i], lost(value, annotation)));
  Object.assign(track.last, lost(annotation.score, annotation));
  context.stage.changed(track);
}

const lost = (value, { optimal_score: optimum }) => ({ value, regret: Math.max(0, optimum - value) });

const ENDINGS = [".json", ".jsonl"];

/** The records of a file: one JSON document, or one per line. The server checks them. @param {File} file @returns {Promise<object[]>} */
async function readFlights(file) {
  if (!ENDINGS.some((ending) => file.name.toLowerCase().endsWith(ending))) {
    throw new Error(`${file.name} is not a flight file: its name must end in ${ENDINGS.join(" or ")}.`);
  }
  const text = await file.text();
  try {
    return [JSON.parse(text)];
  } catch {
    if (!text.trim()) throw new Error(`${file.name} is empty.`);
    return text.split("\n").flatMap((line, i) => {
      if (!line.trim()) return [];
      try {
        const record = JSON.parse(line);
        if (["task", "seed", "agent"].every((name) => name in Object(record))) return [record];
      } catch (error) {
        throw new Error(`${file.name}, line ${i + 1} is not JSON: ${error.message}.`);
      }
      throw new Error(`${file.name}, line ${i + 1} is not a flight.`);
    });
  }
}

/** The button that saves the record of a finished flight. @param {HTMLElement} root @param {Context} context */
export function mountRecord(root, context) {
  const { stage } = context;
  const save = el("button.button.quiet.small", { id: "save-record", text: "Save record", press: () => saveRecord(context) });
  root.append(save);
  stage.on("change", () => (save.disabled = !stage.track?.record && !stage.track?.episode));
}

async function saveRecord(context) {
  const { track, world } = context.stage;
  const record = await tried(() => recordOf(context, track));
  if (!record) return;
  const name = `${world.task.short_name}-${world.seed}-${record.agent}`.replace(/[^\w.-]+/g, "_").slice(0, 100);
  download(`${name}.json`, new Blob([`${JSON.stringify(record, null, 2)}\n`], { type: "application/json" }));
}

/** The file field, and the choice of a flight if the file contains several. */
export function mountFiles(root, past, open) {
  const field = fileField("flight-file", ".json,.jsonl", (file) => {
    // The open choices would cover the flights and the error.
    root.closest("details").open = false;
    return open(() => past.openFile(file));
  });
  const change = () => open(() => past.openRecord(flights.selectedIndex));
  const flights = el("select", { id: "flight-of-file", "aria-label": "Flight of the file", hidden: true, on: { change } });
  root.append(el("div.field", ...field, flights));

  let offered = past.records;
  const { stage } = past.context;
  stage.on("selected", () => past.records.length && (flights.selectedIndex = past.records.indexOf(stage.track.record)));
  stage.on("load", () => {
    if (past.records === offered) return;
    offered = past.records;
    flights.hidden = past.records.length < 2;
    flights.replaceChildren(...past.records.map((record, i) => el("option", { text: `${i + 1}. ${flightName(past.context, record)}` })));
  });
}
