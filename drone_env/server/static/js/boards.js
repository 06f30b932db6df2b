// The boards in the middle: one map with all flights, or one for each of them side by side.
import { Board } from "./board.js";
import { el, icon, setText } from "./dom.js";
import { isLost, outcome, points } from "./format.js";

/** @param {HTMLElement} root @param {import("./context.js").Context} context @returns {{boards: Board[], apart: (apart: boolean) => void}} */
export function mountBoards(root, context) {
  const { stage, camera } = context;
  const grid = el("div.boards", { id: "boards" });
  const tool = (label, d, press) => el("button.icon-button", { "aria-label": label, title: label, press }, icon(d));
  const move = (act) => () => {
    act();
    context.emit("camera");
  };
  const farther = tool("Farther", "M6 12h12", move(() => camera.nearer(-1)));
  const nearer = tool("Nearer", "M12 6v12M6 12h12", move(() => camera.nearer(1)));
  const follow = tool(
    "Follow the drone",
    "M12 4v3M12 17v3M4 12h3M17 12h3M8 12a4 4 0 1 0 8 0a4 4 0 1 0-8 0",
    move(() => {
      camera.following = true;
    }),
  );
  const tools = el("div.map-tools", { role: "group", "aria-label": "Map" }, nearer, farther, follow);
  root.append(el("div.boards-field", grid, tools));
  const mounted = { boards: [], apart };
  let cards = [];
  let isApart = false;
  let shown = [];

  function build() {
    shown = isApart ? stage.tracks : [];
    mounted.boards.forEach((board) => board.destroy());
    grid.style.setProperty("--columns", String(Math.ceil(Math.sqrt(shown.length || 1))));
    cards = shown.map(card);
    const field = el("div.map-field");
    grid.replaceChildren(...(cards.length ? cards.map(({ node }) => node) : [field]));
    mounted.boards = cards.length
      ? cards.map(({ field, track }) => new Board(field, context, track))
      : [new Board(field, context)];
    draw();
  }

  function card(track, i) {
    const field = el("div.map-field");
    const state = el("span.card-state");
    const press = () => stage.select(i);
    const head = el("button.card-head", { press }, el("span.card-name", { text: track.name }), state);
    const node = el("figure.card", { style: { "--lane": `var(${track.colour})` } }, head, field);
    return { node, head, field, state, track };
  }

  function draw() {
    for (const { node, head, state, track } of cards) {
      const frame = track.frameAt(stage.clock.cursor);
      const lost = isLost(frame.regret) ? ` · −${points(frame.regret)}` : "";
      const how = frame.done
        ? `${points(frame.score)} · ${outcome(frame)}`
        : `step ${frame.step} · ${frame.deliveries_done}/${stage.world.parcels.length}${lost}`;
      setText(state, how);
      node.classList.toggle("selected", track === stage.track);
      head.setAttribute("aria-pressed", String(track === stage.track));
    }
    grid.classList.toggle("near", camera.zoom > 1);
    nearer.disabled = camera.nearest;
    farther.disabled = follow.disabled = camera.zoom === 1;
    follow.hidden = camera.following || camera.zoom === 1;
  }

  /** Each flight on a board of its own, or all on one. */
  function apart(wanted) {
    isApart = wanted && stage.tracks.length > 1;
    build();
  }

  stage.on("load", () => {
    camera.reset();
    isApart = isApart && stage.tracks.length > 1;
    if (isApart || shown.length) build();
  });
  stage.on("change", draw);
  context.on("camera", draw);
  listenToDrags(grid, context);
  build();
  return mounted;
}

/** A drag moves a map that is larger than its window, and so do two fingers, which also take it nearer. */
function listenToDrags(grid, context) {
  const { camera } = context;
  const pointers = new Map();
  let apart = 0;

  const spread = () => {
    const [a, b] = [...pointers.values()];
    return Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
  };
  grid.addEventListener("pointerdown", (event) => {
    pointers.set(event.pointerId, event);
    if (pointers.size === 2) apart = spread();
  });
  const gone = (event) => pointers.delete(event.pointerId);
  for (const type of ["pointerup", "pointercancel", "pointerleave"]) grid.addEventListener(type, gone);
  grid.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before || !context.stage.world) return;
    pointers.set(event.pointerId, event);
    // One finger flies where the visitor does.
    if (pointers.size === 1 && event.pointerType !== "mouse" && document.body.classList.contains("human-flies")) return;
    if (pointers.size === 2 && Math.abs(Math.log(spread() / apart)) > 0.3) {
      camera.nearer(spread() > apart ? 1 : -1, cellBelow(event, context).at);
      apart = spread();
    }
    const { cell } = cellBelow(event, context);
    camera.pan((event.clientX - before.clientX) / cell, (event.clientY - before.clientY) / cell);
    context.emit("camera");
  });
  grid.addEventListener(
    "wheel",
    (event) => {
      if (!event.ctrlKey) return;
      event.preventDefault();
      if (!context.stage.world) return;
      if (camera.nearer(event.deltaY < 0 ? 1 : -1, cellBelow(event, context).at)) context.emit("camera");
    },
    { passive: false },
  );
}

/** Side of a cell in CSS pixels, and which one lies below the pointer, [x, y]. */
function cellBelow({ target, currentTarget, clientX, clientY }, { camera, stage }) {
  const map = target.closest(".map") ?? currentTarget.querySelector(".map");
  const { x, y, width, height } = map.getBoundingClientRect();
  const scale = window.devicePixelRatio || 1;
  const size = { width: width * scale, height: height * scale, scale };
  const { cell, left, top } = camera.layout(stage.world, size, [stage.frame.x, stage.frame.y]);
  return { cell: cell / scale, at: [((clientX - x) * scale - left) / cell, ((clientY - y) * scale - top) / cell] };
}
