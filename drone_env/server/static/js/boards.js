// The map with its zoom buttons and drags.
import { Board } from "./board.js";
import { el, icon } from "./dom.js";

/** The minimum size of a cell in CSS pixels when the visitor starts to fly. */
const BY_HAND = 16;
/** How much farther or nearer two fingers come before the map zooms one step. */
const PINCH = 1.3;
/** The share of the window over which the drone and its target may be apart. */
const SEEN = 0.75;

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
    move(() => (camera.following = true)),
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
  context.on("drawn", (view) => {
    if (view.world === seen) return;
    seen = view.world;
    lookAtTarget(context, view);
    context.emit("camera");
  });
  stage.on("load", () => camera.reset());
  stage.on("change", draw);
  context.on("camera", draw);
  listenToDrags(grid, context);
  return new Board(field, context);
}

/** Zooms in until the cells are large enough for a visitor who flies, while drone and target are in view. */
function lookAtTarget({ stage, camera }, { size, track, layout }) {
  if (!stage.tracks.some((one) => one.byHand)) return;
  const { x, y, target } = track.last;
  const [tx, ty] = target ?? [x, y];
  const apart = Math.max(Math.abs(tx - x) / size.width, Math.abs(ty - y) / size.height);
  const cell = () => camera.whole * camera.zoom;
  while (cell() < BY_HAND * layout.scale && camera.nearer(1));
  while (cell() * apart > SEEN && camera.nearer(-1));
  if (camera.zoom > 1) camera.centre = [(x + tx + 1) / 2, (y + ty + 1) / 2];
}

/** A drag moves a map that is larger than its window, and two fingers also zoom it. @param {Context} context */
function listenToDrags(grid, context) {
  const { camera, stage } = context;
  /** What points at the map, by id. @type {Map<number, PointerEvent>} */
  const down = new Map();
  let apart = 0;
  const spread = ([a, b] = [...down.values()]) => (b ? Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY) : 0);
  grid.addEventListener("pointerdown", (event) => {
    down.set(event.pointerId, event);
    apart = spread();
  });
  for (const type of ["pointerup", "pointercancel", "pointerleave"])
    grid.addEventListener(type, ({ pointerId }) => {
      down.delete(pointerId);
      apart = spread();
    });
  grid.addEventListener("pointermove", (event) => {
    const before = down.get(event.pointerId);
    if (!before || !stage.world) return;
    // If the visitor flies, a swipe of one finger flies.
    if (event.pointerType !== "mouse" && down.size === 1 && document.body.classList.contains("human-flies")) return;
    down.set(event.pointerId, event);
    const now = spread();
    if (now > apart * PINCH ? camera.nearer(1) : now * PINCH < apart && camera.nearer(-1)) apart = now;
    const cell = camera.cell * down.size;
    camera.pan((event.clientX - before.clientX) / cell, (event.clientY - before.clientY) / cell);
    context.emit("camera");
  });
}
