// The layers of a map, from the ground up. To add a layer, add an entry here.
import { drawCity, drawSigns, isJoined } from "./layer_city.js";
import { drawBest, drawDrones, drawParcels, drawThoughts, drawTrails } from "./layer_flights.js";
import { drawBlocks, drawNames, drawScale } from "./layer_places.js";
import { drawRange, drawValues } from "./layer_values.js";

/** @type {Layer[]} */
export const LAYERS = [
  { id: "city", place: "ground", draw: (ctx, view) => (isJoined(view.world) ? drawBlocks : drawCity)(ctx, view) },
  { id: "names", place: "ground", draw: drawNames },
  {
    id: "values",
    place: "cells",
    name: "Best moves",
    hint: "The best moves from each cell, with the present battery, parcels and steps. Point at a cell to see its five values",
    key: "v",
    needsValues: true,
    draw: drawValues,
  },
  {
    id: "range",
    place: "cells",
    name: "Battery range",
    hint: "An outline around the cells in reach of the battery",
    key: "b",
    on: ({ stage }) => stage.track?.byHand ?? false,
    when: ({ world }) => Boolean(world?.task.pads),
    draw: drawRange,
  },
  { id: "signs", place: "air", draw: drawSigns },
  { id: "scale", place: "air", draw: drawScale },
  { id: "trails", place: "air", draw: drawTrails },
  {
    id: "best",
    place: "air",
    name: "Best flight",
    hint: "A best flight as a ghost, after the end of the selected flight",
    key: "g",
    on: () => true,
    when: ({ track }) => Boolean(track?.annotation),
    draw: drawBest,
  },
  { id: "parcels", place: "air", draw: drawParcels },
  {
    id: "thoughts",
    place: "air",
    name: "Network values",
    hint: "An arrow for each move: the longer, the higher its value",
    key: "q",
    on: () => true,
    when: ({ track }) => Boolean(track?.weighed && track.ours),
    draw: drawThoughts,
  },
  { id: "drones", place: "air", draw: drawDrones },
];
