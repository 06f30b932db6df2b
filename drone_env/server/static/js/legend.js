// The legend of the map, and the attribution of its data.
import { BLOCKS, drawBlocks, isJoined } from "./blocks.js";
import { el } from "./dom.js";
import { drawFigure } from "./figures.js";
import { cellName } from "./format.js";

const SIDE = 24;
const LEFT_OUT = new Set(["road", "unknown", "drone"]);
const OPEN_STREET_MAP = "https://www.openstreetmap.org/copyright";

/** @param {HTMLElement} root @param {Context} context */
export function mountLegend(root, context) {
  const signs = context.kinds
    .filter((kind) => !LEFT_OUT.has(kind.name))
    .map((kind) => ({
      kind,
      entry: el("li", { title: kind.effect }, drawSign(kind.name), el("span", { text: cellName(kind.name) })),
    }));
  const credit = el("p.credit", { hidden: true });
  root.append(el("ul.legend", { "aria-label": "Legend" }, ...signs.map(({ entry }) => entry)));
  document.querySelector(".boards-field").append(credit);

  /** Shows only the kinds of cells on the present map, as they are drawn there. */
  function show() {
    const { world } = context.stage;
    if (!world) return;
    const there = new Set(world.cells.flat());
    for (const { kind, entry } of signs) {
      entry.hidden = kind.name !== "delivered" && !there.has(kind.id);
      if (BLOCKS.has(kind.name)) entry.firstChild.replaceWith(drawSign(kind.name, isJoined(world)));
    }
    const { attribution } = world.task;
    credit.hidden = !attribution;
    const about = attribution.includes("OpenStreetMap");
    credit.replaceChildren(about ? el("a", { href: OPEN_STREET_MAP, rel: "external", text: attribution }) : attribution);
  }
  context.stage.on("load", show);
  context.on("theme", show);
}

/** The figure of a kind of cell, or its block, on a canvas of 24 by 24. */
export function drawSign(name, asBlock = false) {
  const scale = window.devicePixelRatio || 1;
  const side = SIDE * scale;
  const canvas = el("canvas", { "aria-hidden": "true", width: side, height: side });
  const ctx = canvas.getContext("2d");
  const layout = { cell: 18 * scale, left: 3 * scale, top: 3 * scale, scale };
  if (asBlock) drawBlocks(ctx, { world: { cells: [[0]], width: 1, height: 1 }, layout, names: [name] });
  else drawFigure(ctx, name === "delivery" ? "parcel" : name, side / 2, side / 2, side);
  return canvas;
}
