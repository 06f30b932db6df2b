// Formats numbers and names.

const MINUS = "\u2212";
/** That of the page, whose texts and decimal points are English. */
export const LOCALE = "en-GB";

/** @param {number|null|undefined} value @param {(value: number) => string} write */
const known = (value, write) => (value === null || value === undefined ? "–" : write(value));

/** A number with a fixed count of digits; "–" for null. */
export const fixed = (number, digits = 2) => known(number, (value) => value.toFixed(digits).replace("-", MINUS));

export const signed = (number, digits = 2) => known(number, (value) => (value >= 0 ? "+" : "") + fixed(value, digits));

export const thousands = (count) => (count === null ? "" : count.toLocaleString(LOCALE));

export const counted = (count, thing) => `${thousands(count)} ${thing}${count === 1 ? "" : "s"}`;

/** A score of 0 to 1, times 100. */
export const points = (score, digits = 1) => known(score, (value) => fixed(value * 100, digits));

/** The points between neighbours of ascending scores, of the rounded scores: they add up. */
export const pointsBetween = (...scores) => scores.slice(1).map((score, i) => rounded(score) - rounded(scores[i]));

const rounded = (score) => Number((100 * score).toFixed(1));

/** The optimum of a flight's map, or null while it is unknown. @param {Track} track */
export const optimumOf = ({ annotation, frames }) => annotation?.optimum?.score ?? frames[0].value;

/** What a flight has lost at a frame, in points. @param {Track} track */
export function lossOf(track, { done, score, value }) {
  const best = optimumOf(track);
  return best === null || value === null ? "–" : fixed(pointsBetween(done ? score : value, best)[0], 1);
}

export const percent = (share, digits = 0) => known(share, (value) => `${fixed(value * 100, digits)} %`);

const DRAWN = /^drawn_[0-9a-f]{12}$/;

/** Whether a task has more than one map: a drawn one has not. */
export const variants = (task) => task?.family !== "drawn";

/** `skyline_hard` -> `Skyline Hard`, `drawn_aadbbe374784` -> `Drawn map aadb`. */
export function title(name) {
  if (name === "battery_dead") return OUTCOMES.battery_dead;
  if (DRAWN.test(name)) return `Drawn map ${name.slice(6, 10)}`;
  return name
    .split("_")
    .map((word) => word.charAt(0).toUpperCase() + word.slice(1))
    .join(" ");
}

const OUTCOMES = {
  flying: "In flight",
  delivered: "All parcels delivered",
  battery_dead: "Battery empty",
  out_of_steps: "Out of steps",
};

export const cellName = (name) => ({ delivery: "Parcel", delivered: "Delivered parcel" })[name] ?? title(name);

export const outcome = ({ outcome }) => OUTCOMES[outcome] ?? outcome;

/** Whether a loss is visible with one decimal. */
export const isLost = (regret) => regret > 0.0005;

export const moment = (iso) => new Date(iso).toLocaleString(LOCALE, { dateStyle: "medium", timeStyle: "medium" });

export const ARROWS = { UP: "↑", DOWN: "↓", LEFT: "←", RIGHT: "→", WAIT: "•" };

/** The name of a pilot; of an unknown one, its id. @param {Context} context */
export function who(context, id) {
  const { automatic, name } = context.pilot(id);
  return automatic ? name : "A person";
}

/** Who flew, and with what help: `Ada with undo from step 3 of Greedy`. @param {Context} context @param {Provenance} provenance */
export function inWords(context, { pilot, person, values_used, undo_used, parent }) {
  const help = [values_used && "values", undo_used && "undo"].filter(Boolean).join(" and ");
  const flown = (person ?? who(context, pilot)) + (help && ` with ${help}`);
  return parent ? `${flown} from step ${parent.step} of ${inWords(context, parent)}` : flown;
}

/** Capitalises a message of the server, unless it begins with the name of a file or a field. */
export const sentence = (text) => text.replace(/^[a-z](?=[a-z]*[ ,:;])/, (letter) => letter.toUpperCase());

const LONGEST = 40;

/** A name in a place that cannot grow. */
export const shortened = (name) => (name.length > LONGEST ? `${name.slice(0, LONGEST)}…` : name);

/** A flight of the store or of a file in words: `Hard, map 7, Greedy`. @param {Context} context */
export function flightName(context, { task, seed, agent, ...flown }) {
  const { short_name } = context.task(task) ?? { short_name: String(task) };
  return `${title(short_name)}, map ${seed}, ${inWords(context, { ...flown, pilot: flown.pilot ?? agent })}`;
}

/** What the score of a task counts. @param {Answer<"TaskInfo">} task */
export function scoring({ score_weights: { parcels, battery, steps }, score_range: range, efficiency_needs_all: all }) {
  const rest = all ? ", these two only once all parcels are delivered" : "";
  const [lowest, highest] = range.map((end) => points(end));
  return `What counts: parcels (${parcels} points), then battery left (${battery}) and steps left (${steps})${rest}. The lowest score is ${lowest}, the highest ${highest}.`;
}
