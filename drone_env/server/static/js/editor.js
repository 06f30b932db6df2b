// Draw: a map editor. The server computes the optimum, stores the map as a task and writes its file.
import { ApiError, tried } from "./api.js";
import { Emitter, recall, remember } from "./base.js";
import { mountBoards } from "./boards.js";
import { Camera } from "./camera.js";
import { add } from "./context.js";
import { download, el, icon, onPress, setText, toast } from "./dom.js";
import { Drawing } from "./drawing.js";
import { mountInput } from "./editor_input.js";
import { Worth } from "./editor_worth.js";
import { cellName } from "./format.js";
import { goneFrom, MAP, openField } from "./history.js";
import { drawSign } from "./legend.js";
import { copyLink } from "./router.js";
import { Stage } from "./stage.js";
import { Track } from "./track.js";

const EMPTY = 12;
const SHOWN = new Set(["city", "signs", "best", "parcels", "drones"]);
const PALETTE = ["move", "road", "building", "tree", "obstacle", "pad", "parcel", "start"];
const MOVE = "M12 3v18M3 12h18M9 6l3-3 3 3M9 18l3 3 3-3M6 9l-3 3 3 3M18 9l3 3-3 3";

/** Where this tab keeps the drawing of an address: Back and Reload restore it. @param {Partial<Address>} address */
const keyOf = ({ file, task, seed }) => `${MAP} ${file ?? `${task ?? ""} ${seed ?? 0}`}`;
const keep = (key, map) => remember(key, JSON.stringify(map), "sessionStorage");

/** @param {HTMLElement} root @param {Context} context */
export function mountEditor(root, context) {
  const { api, router, kinds } = context;
  const own = Object.assign(new Emitter(), context, {
    listeners: new Map(),
    stage: new Stage(),
    camera: new Camera(),
    shows: (id) => SHOWN.has(id),
  });
  context.on("theme", () => own.emit("theme"));
  const { stage } = own;
  const drawing = new Drawing(kinds);
  let key = null;

  root.append(document.getElementById("draw").content);
  const tools = root.querySelector("fieldset");
  tools.append(...PALETTE.map(choice));
  const [undoing, , ...acts] = root.querySelectorAll("button");
  onPress(root, {
    "undo-drawing": () => drawing.undo(),
    "empty-map": () => (isOpen() ? drawing.edit(() => (drawing.map = empty())) : become(keyOf(router.address), empty())),
    "fly-map": () => tried(async () => router.go(await stored(false))),
    "race-map": () => tried(async () => router.go(await stored(true))),
    "link-map": () => tried(async () => copyLink(await stored(false))),
    "save-map": () => tried(save),
  });
  const worth = new Worth(root, context, drawing);
  root.querySelector(".field").append(...openField(context, "map-file", toast));
  const numbers = root.querySelector(".draw-numbers");
  const fields = [...numbers.querySelectorAll("input")];
  const sides = fields.slice(0, 2);
  for (const field of fields) {
    const change = sides.includes(field) ? resize : setNumber;
    field.addEventListener("change", () => field.reportValidity() && change(field));
    field.addEventListener("blur", fill);
  }
  root.classList.add("draw");
  /** @type {HTMLElement} */
  const middle = root.querySelector(".middle");
  const board = mountBoards(middle, own);
  /** @type {HTMLElement} */
  const grid = middle.querySelector(".boards");
  Object.assign(grid, { id: "drawing", tabIndex: 0, ariaLabel: "Map: arrow keys move the cursor, Space or Enter paints", role: "application" });
  const paints = [...tools.querySelectorAll("input")];
  const point = mountInput(grid, own, drawing, (i) => {
    paints[i]?.click();
    return i in paints;
  });

  function choice(name) {
    const kind = kinds.find((one) => one.name === name);
    const sign = name === "move" ? icon(MOVE) : drawSign(name === "start" ? "drone" : name);
    const input = el("input", { type: "radio", name: "paint", value: name, on: { change: () => (drawing.tool = name) } });
    input.checked = name === drawing.tool;
    return el("label.paint", { title: kind?.effect }, input, sign, el("span", { text: cellName(name) }));
  }

  drawing.on("stroke", changed);
  drawing.on("map", show);
  drawing.on("last", () => toast("A map needs a parcel. Move this one, or add another one first."));
  drawing.on("end", () => {
    keep(key, drawing.map);
    turns();
  });

  function turns() {
    undoing.disabled = !drawing.past.length;
  }

  function setNumber({ name, value }) {
    drawing.setNumber(name, value === "" ? null : Number(value));
  }

  function resize() {
    if (sides.every(({ value, validity }) => value && validity.valid)) drawing.resize(...sides.map(({ value }) => Number(value)));
  }

  function show() {
    turns();
    changed();
    stage.show(stage.world, stage.tracks);
    point();
  }

  function draw() {
    const { map } = drawing;
    const [height, width] = [map.cells.length, map.cells[0].length];
    const [x, y] = map.start;
    const frames = [{ x, y, step: 0, done: false, delivered: [], target: null }];
    /** Only what the board reads. @type {any} */
    const start = { opening: { pilot: "", forked_at: null }, frames };
    const track = Object.assign(new Track(context, start), { colour: "--accent" });
    /** @type {any} */
    const world = { task: { short_name: "drawing", attribution: map.attribution }, seed: 0, width, height };
    stage.world = { ...world, cells: map.cells, parcels: map.parcels };
    stage.tracks = [track];
    board.reload();
    setText(document.getElementById("map-credit"), map.attribution);
    drawBest();
  }

  function drawBest() {
    if (stage.track) {
      /** @type {any} */
      const best = worth.answer?.optimum ? { optimal_path: worth.answer.optimum.path, moves: [] } : null;
      stage.track.annotation = best;
      board.refresh();
    }
    fill();
  }
  worth.on("answer", (wrong) => {
    for (const button of acts) button.disabled = wrong !== null;
    drawBest();
  });

  function fill() {
    const { map } = drawing;
    const drawn = map && { columns: map.cells[0].length, rows: map.cells.length, ...map.numbers };
    for (const field of fields) {
      field.disabled = map === null;
      if (document.activeElement !== field) field.value = drawn?.[field.name] ?? "";
      field.placeholder = worth.answer?.numbers[field.name] ?? "";
    }
  }

  function changed() {
    draw();
    // Stored once per stroke: storage is slow.
    if (!drawing.stroke) keep(key, drawing.map);
    worth.ask();
  }

  /** Stores the map; the address where the visitor flies it, in a race with all others who can. */
  async function stored(race) {
    const answer = await api.post("maps", drawing.map);
    add(context, answer);
    const { id } = answer.task;
    const flying = context.pilots.filter(({ automatic, tasks }) => (race ? tasks.includes(id) : !automatic));
    return { task: id, seed: 0, pilots: flying.map((pilot) => pilot.id).slice(0, context.most) };
  }

  async function save() {
    const { name, toml } = await api.post("maps/worth", drawing.map);
    download(`${name}.toml`, new Blob([toml], { type: "application/toml" }));
  }

  document.addEventListener("keydown", (event) => {
    const isNumber = event.target instanceof HTMLInputElement && event.target.type === "number";
    const undoes = (event.ctrlKey || event.metaKey) && event.key === "z";
    if (!undoes || context.view !== "draw" || isNumber) return;
    event.preventDefault();
    drawing.undo();
  });

  /** Whether the editor has the map of the address. */
  const isOpen = () => key === keyOf(router.address) && drawing.map !== null;

  // The address selects the map.
  async function look() {
    const { address } = router;
    const { view, file, task, seed } = address;
    const wanted = keyOf(address);
    if (view !== "draw" || isOpen()) return;
    // On a new map there is nothing to move.
    paints[PALETTE.indexOf(file || task ? "move" : "building")].click();
    let found = JSON.parse(recall(wanted, "sessionStorage")) ?? (file || task ? null : empty());
    let wrong = file && !found ? goneFrom(file) : null;
    try {
      if (!file) found ??= await api.get(`maps/${encodeURIComponent(task)}/${seed ?? 0}`);
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      wrong = error.message.replace("path.seed", "The number of the map");
    }
    // Meanwhile the visitor may have gone elsewhere, or begun an empty map.
    if (wanted !== keyOf(router.address) || isOpen()) return;
    become(wanted, found);
    if (wrong !== null) worth.show(null, wrong);
  }

  function empty() {
    return { cells: drawing.empty(EMPTY, EMPTY), start: [0, 0], parcels: [[EMPTY - 1, EMPTY - 1]], numbers: {} };
  }

  function become(wanted, found) {
    key = wanted;
    worth.answer = null;
    drawing.become(found);
    point(null);
    if (found) show();
    else stage.show(null, []);
    turns();
  }

  router.on("address", look);
  context.server.on("state", ({ state }) => state === "open" && !worth.problem.hidden && (drawing.map ? worth.ask() : look()));
  look();
}
