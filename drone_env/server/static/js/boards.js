// The map with its zoom buttons and drags.
import { Board } from "./board.js";
import { el, icon } from "./dom.js";

/** The minimum size of a cell in CSS pixels when the visitor starts to fly. */
const BY_HAND = 22;

/** @param {HTMLElement} root @param {Context} context */
export function mountBoards(root, context) {
  const { stage, camera } = context;
  const field = el("div.map-field");
  const grid = el("div.boards", { id: "boards" }, field);
  const tool = (label, d, press) => el("button.icon-button", { "aria-label": label, title: label, press }, icon(d));
  const move = (act) => () => {
    act();
    context.emit("camera");
  };
  const farther = tool("Zoom out", "M6 12h12", move(() => camera.nearer(-1)));
  const nearer = tool("Zoom in", "M12 6v12M6 12h12", move(() => camera.nearer(1)));
  const follow = tool(
    "Follow the drone",
    "M12 4v3M12 17v3M4 12h3M17 12h3M8 12a4 4 0 1 0 8 0a4 4 0 1 0-8 0",
    move(() => {
      camera.following = true;
    }),
  );
  const tools = el("div.map-tools", { role: "group", "aria-label": "Map" }, nearer, farther, follow);
  root.append(el("div.boards-field", grid, tools));

  function draw() {
    grid.classList.toggle("near", camera.zoom > 1);
    nearer.disabled = camera.nearest;
    farther.disabled = follow.disabled = camera.zoom === 1;
    follow.hidden = camera.following || camera.zoom === 1;
  }

  let seen = null;
  context.on("drawn", ({ world, layout }) => {
    if (world === seen) return;
    seen = world;
    if (nearEnough(context, layout.scale)) context.emit("camera");
  });
  stage.on("load", () => camera.reset());
  stage.on("change", draw);
  context.on("camera", draw);
  listenToDrags(grid, context);
  const board = new Board(field, context);
  draw();
  return board;
}

/** Zooms in until the cells are large enough for a visitor who flies. @returns {boolean} Whether it zoomed. */
function nearEnough({ stage, byHand, camera }, scale) {
  if (!stage.tracks.some(byHand)) return false;
  let moved = false;
  while (camera.whole * camera.zoom < BY_HAND * scale && camera.nearer(1)) moved = true;
  return moved;
}

/** A drag moves a map that is larger than its window. @param {Context} context */
function listenToDrags(grid, context) {
  const { camera, stage } = context;
  let before = null;
  grid.addEventListener("pointerdown", (event) => {
    before = event.isPrimary ? event : null;
  });
  for (const type of ["pointerup", "pointercancel", "pointerleave"]) grid.addEventListener(type, () => (before = null));
  grid.addEventListener("pointermove", (event) => {
    if (!before || !event.isPrimary || !stage.world) return;
    // If the visitor flies, a swipe flies.
    if (event.pointerType !== "mouse" && document.body.classList.contains("human-flies")) return;
    camera.pan((event.clientX - before.clientX) / camera.cell, (event.clientY - before.clientY) / camera.cell);
    before = event;
    context.emit("camera");
  });
}
