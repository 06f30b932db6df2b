// What the figures on the map are, as the server names them.
import { el } from "./dom.js";
import { drawFigure } from "./figures.js";
import { cellName } from "./format.js";

const SIDE = 24;
const LEFT_OUT = new Set(["road", "unknown", "drone"]);

/** @param {HTMLElement} root @param {import("./context.js").Context} context */
export function mountLegend(root, context) {
  const signs = context.kinds
    .filter((kind) => !LEFT_OUT.has(kind.name))
    .map((kind) => ({
      kind,
      entry: el("li", { title: kind.effect }, drawSign(kind.name), el("span", { text: cellName(kind.name) })),
    }));
  root.append(el("ul.legend", { "aria-label": "Legend" }, ...signs.map(({ entry }) => entry)));

  /** Only what can be met on the map that is shown. */
  context.stage.on("load", () => {
    const there = new Set(context.stage.world.cells.flat());
    for (const { kind, entry } of signs) entry.hidden = kind.name !== "delivered" && !there.has(kind.id);
  });
}

/** The figure of a kind of cell on a canvas of 24 by 24. */
export function drawSign(kind) {
  const side = SIDE * (window.devicePixelRatio || 1);
  const canvas = el("canvas", { "aria-hidden": "true", width: side, height: side });
  drawFigure(canvas.getContext("2d"), kind === "delivery" ? "parcel" : kind, side / 2, side / 2, side);
  return canvas;
}
