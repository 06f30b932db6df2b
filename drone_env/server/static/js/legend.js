// What the signs on the map are: drawn by the painters of the map itself, named by the server.
import { el } from "./dom.js";
import { title } from "./format.js";
import { drawDelivered, drawParcel } from "./map_sprites.js";
import { drawKind } from "./map_terrain.js";
import { palette } from "./palette.js";

const SIDE = 24;
const LEFT_OUT = new Set(["road", "unknown", "drone"]);

/** @param {HTMLElement} root @param {import("./context.js").Context} context */
export function mountLegend(root, context) {
  const signs = context.kinds
    .filter((kind) => !LEFT_OUT.has(kind.name))
    .map((kind) => {
      const canvas = el("canvas", { "aria-hidden": "true" });
      const entry = el("li", { title: kind.effect }, canvas, el("span", { text: title(kind.name) }));
      return { kind, canvas, entry };
    });
  root.append(el("ul.legend", { "aria-label": "Legend" }, ...signs.map(({ entry }) => entry)));

  function draw() {
    for (const { kind, canvas } of signs) drawSign(canvas, kind.name);
  }
  context.on("theme", draw);
  draw();

  /** Only what can be met on the map that is shown. */
  context.on("missions", ([player]) => {
    if (!player?.mission) return;
    const there = new Set(player.mission.cells.flat());
    for (const { kind, entry } of signs) entry.hidden = kind.name !== "delivered" && !there.has(kind.id);
  });
}

/** Draws the sign of a kind of cell on a canvas of 24 by 24. */
export function drawSign(canvas, name) {
  const scale = window.devicePixelRatio || 1;
  const side = SIDE * scale;
  canvas.width = canvas.height = side;
  const ctx = canvas.getContext("2d");
  const colours = palette();
  if (name === "delivery") drawParcel(ctx, side / 2, side / 2, side, colours);
  else if (name === "delivered") drawDelivered(ctx, side / 2, side / 2, side, colours);
  else drawKind(ctx, name, 0, 0, side, [0.5, 0.1, 0.4], colours.map);
}
