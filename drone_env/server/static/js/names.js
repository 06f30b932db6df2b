// How flights of everybody are called.
import { title } from "./format.js";

/** Who flew, as lists of everybody's flights have it: `human from step 3 of greedy` -> `A person from step 3 of Greedy`. */
export function who({ pilots }, agent) {
  const called = ({ name, automatic }) => (automatic ? name : "A person");
  return String(agent).replace(/(^| from step \d+ of )([^ ]+)/g, (whole, before, id) => {
    const pilot = pilots.find((one) => one.id === id);
    return pilot ? before + called(pilot) : whole;
  });
}

/** A flight in words: `Hard, map 7, Greedy`. @param {object} record */
export function flightName(context, { task, seed, agent }) {
  const known = context.tasks.find(({ id }) => id === task);
  return `${title(known?.short_name ?? String(task))}, map ${seed}, ${who(context, agent)}`;
}
