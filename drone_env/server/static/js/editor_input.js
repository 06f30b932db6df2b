// The pointer and the keyboard of the map editor: strokes over its map, and a cursor.
import { announce, el } from "./dom.js";
import { cellName } from "./format.js";

const ARROWS = { ArrowUp: [0, -1], ArrowDown: [0, 1], ArrowLeft: [-1, 0], ArrowRight: [1, 0] };

/**
 * @param {HTMLElement} grid Contains the canvas. @param {Context} context Of the editor. @param {Drawing} drawing
 * @param {(i: number) => boolean} choose Chooses a tool; false if there is no such tool.
 * @returns {(cell?: number[]|null) => void} Moves the cursor to a cell, or hides it; without one, keeps it if the map still contains its cell.
 */
export function mountInput(grid, context, drawing, choose) {
  const { camera } = context;
  let cursor = null;
  const mark = el("i.draw-cursor", { hidden: true });
  grid.append(mark);

  const layout = () => {
    const { width, height } = grid.querySelector(".map").getBoundingClientRect();
    const scale = window.devicePixelRatio || 1;
    return camera.layout(context.stage.world, { width: width * scale, height: height * scale, scale }, drawing.map.start);
  };
  const cellBelow = ({ clientX, clientY }) => {
    const box = grid.querySelector(".map").getBoundingClientRect();
    const { cell, left, top, scale } = layout();
    return [clientX - box.left, clientY - box.top].map((p, i) => Math.floor((p * scale - [left, top][i]) / cell));
  };
  grid.addEventListener("pointerdown", (event) => {
    point(null);
    if (event.button !== 0 || !event.isPrimary || !drawing.map || !drawing.inside(cellBelow(event))) return;
    drawing.begin(cellBelow(event));
    // The stroke goes on if the pointer leaves the map and comes back elsewhere.
    if (drawing.stroke) grid.setPointerCapture(event.pointerId);
  });
  grid.addEventListener(
    "pointermove",
    (event) => {
      if (!drawing.stroke) return;
      event.stopImmediatePropagation();
      if (event.isPrimary) drawing.goOn(cellBelow(event));
    },
    { capture: true },
  );
  for (const type of ["pointerup", "pointercancel"]) grid.addEventListener(type, () => drawing.end());

  function follow([x, y]) {
    if (camera.zoom === 1) return;
    camera.centre = [x + 0.5, y + 0.5];
    camera.following = false;
    context.emit("camera");
  }

  function point(cell) {
    cursor = cell;
    mark.hidden = cell === null;
    if (!cell) return;
    const { cell: side, left, top, scale } = layout();
    const place = { left: left + cell[0] * side, top: top + cell[1] * side, width: side, height: side };
    for (const [name, pixels] of Object.entries(place)) mark.style[name] = `${pixels / scale}px`;
    const held = Boolean(drawing.stroke?.held);
    mark.classList.toggle("holds", held);
    announce(`Column ${cell[0]}, row ${cell[1]}: ${cellName(drawing.nameAt(cell))}${held ? ", held" : ""}`);
  }
  grid.addEventListener("keydown", (event) => {
    const way = ARROWS[event.key];
    if (!drawing.map) return;
    if ((event.ctrlKey || event.metaKey) && event.key === "z") drawing.undo();
    else if (event.ctrlKey || event.metaKey || event.altKey) return;
    else if (way) {
      const next = cursor ? [cursor[0] + way[0], cursor[1] + way[1]] : drawing.map.start;
      if (drawing.inside(next)) {
        drawing.goOn(next);
        const to = drawing.stroke?.held ?? next;
        follow(to);
        point(to);
      }
    } else if ((event.key === " " || event.key === "Enter") && cursor) {
      // A held item moves along until the next press.
      if (drawing.stroke) drawing.end();
      else drawing.begin(cursor);
      if (!drawing.stroke?.held) drawing.end();
      point(cursor);
    } else if ("+=-".includes(event.key)) {
      if (camera.nearer(event.key === "-" ? -1 : 1)) context.emit("camera");
      if (cursor) follow(cursor);
    } else if (!choose(Number(event.key) - 1)) return;
    event.preventDefault();
  });
  grid.addEventListener("blur", () => {
    drawing.end();
    mark.hidden = true;
  });
  context.on("camera", () => cursor && point(cursor));

  return (cell = cursor && drawing.inside(cursor) ? cursor : null) => point(cell);
}
