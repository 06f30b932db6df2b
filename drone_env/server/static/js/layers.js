// What can be shown on a map, from the ground up. A layer is added here, and nowhere else.
import { drawCity } from "./layer_city.js";
import { drawBest, drawDrones, drawParcels, drawThoughts, drawTrails } from "./layer_flights.js";
import { drawNetwork, drawRange, drawValues } from "./layer_values.js";

/**
 * @typedef {Object} Layer
 * @property {string} id @property {"ground"|"cells"|"air"} place "air" is drawn in every animation frame, the others when what they
 *   show has changed.
 * @property {string} [name] What its switch is called; without one it is always shown. @property {string} [key] That flicks it.
 * @property {string} [hint] @property {boolean} [on] Whether it is shown until the visitor says otherwise.
 * @property {boolean} [asks] Whether it shows what `POST /values` says.
 * @property {(stage: import("./stage.js").Stage) => boolean} [when] Whether there is anything to show.
 * @property {(ctx: CanvasRenderingContext2D, view: Object) => void} draw
 */

/** @type {Layer[]} */
export const LAYERS = [
  { id: "city", place: "ground", draw: drawCity },
  {
    id: "values",
    place: "cells",
    name: "Best from everywhere",
    hint: "What is best from each cell, with the battery, parcels and steps of this moment; the greener, the more is still possible",
    key: "v",
    asks: true,
    draw: drawValues,
  },
  {
    id: "network",
    place: "cells",
    name: "Where the network errs",
    hint: "The network's move at each cell where it gives something away",
    key: "e",
    asks: true,
    draw: drawNetwork,
  },
  {
    id: "range",
    place: "cells",
    name: "Range of the battery",
    hint: "What can be reached with the battery that is left; the numbers are the units left there",
    key: "b",
    asks: true,
    when: ({ world }) => Boolean(world?.task.pads),
    draw: drawRange,
  },
  { id: "trails", place: "air", draw: drawTrails },
  {
    id: "best",
    place: "air",
    name: "A best flight",
    hint: "As a ghost, once the flight that is looked at has ended",
    key: "g",
    on: true,
    when: ({ track }) => Boolean(track?.annotation),
    draw: drawBest,
  },
  { id: "parcels", place: "air", draw: drawParcels },
  {
    id: "thoughts",
    place: "air",
    name: "What the network thinks",
    hint: "An arrow for each move, as long as the network values it",
    key: "q",
    on: true,
    when: ({ track }) => Boolean(track?.weighed),
    draw: drawThoughts,
  },
  { id: "drones", place: "air", draw: drawDrones },
];
