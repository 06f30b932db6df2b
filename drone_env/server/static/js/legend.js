// The figures of the kinds of cells for legends, and the attribution of a map's data.
import { el } from "./dom.js";
import { drawFigure } from "./figures.js";

const SIDE = 24;
const OPEN_STREET_MAP = "https://www.openstreetmap.org/copyright";

/** The attribution below the map. @param {Context} context */
export function mountCredit({ stage }) {
  const credit = el("p.credit", { hidden: true });
  document.querySelector(".boards-field").append(credit);
  stage.on("load", () => {
    const { attribution } = stage.world.task;
    credit.hidden = !attribution;
    const about = attribution.includes("OpenStreetMap");
    credit.replaceChildren(about ? el("a", { href: OPEN_STREET_MAP, rel: "external", text: attribution }) : attribution);
  });
}

/** The figure of a kind of cell on a canvas of 24 by 24. */
export function drawSign(name) {
  const side = SIDE * (window.devicePixelRatio || 1);
  const canvas = el("canvas", { "aria-hidden": "true", width: side, height: side });
  drawFigure(canvas.getContext("2d"), name === "delivery" ? "parcel" : name, side / 2, side / 2, side);
  return canvas;
}
