// Draw: a map editor. The server computes the optimum, stores the map as a task and writes its file.
import { tried } from "./api.js";
import { Emitter, recall, remember } from "./base.js";
import { mountBoard } from "./board.js";
import { Camera } from "./camera.js";
import { add } from "./context.js";
import { download, el, icon, onPress, setText, toast } from "./dom.js";
import { Drawing } from "./drawing.js";
import { mountInput } from "./editor_input.js";
import { cellName, counted, points } from "./format.js";
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
  /** Where the map is kept, and its answer of `POST /maps/worth`; null while the server computes. */
  let [key, worth] = [null, null];
  let [isAsking, isStale] = [false, false];

  root.append(document.getElementById("draw").content);
  root.classList.add("draw");
  const tools = root.querySelector("fieldset");
  tools.append(...PALETTE.map(choice));
  const paints = [...tools.querySelectorAll("input")];
  const [undo, , ...acts] = root.querySelectorAll("button");
  const score = root.querySelector("#map-optimum");
  const note = root.querySelector("#map-note");
  /** @type {HTMLElement} */
  const problem = root.querySelector(".problem");
  onPress(root, {
    "undo-drawing": () => drawing.undo(),
    "empty-map": () => (isOpen() ? drawing.edit(() => (drawing.map = empty())) : become(keyOf(router.address), empty())),
    "fly-map": () => tried(async () => router.go(await stored(false))),
    "race-map": () => tried(async () => router.go(await stored(true))),
    "link-map": () => tried(async () => copyLink(await stored(false))),
    "save-map": () => tried(save),
  });
  root.querySelector(".field").append(...openField(context, "map-file", toast));
  const fields = [...root.querySelector(".draw-numbers").querySelectorAll("input")];
  const sides = fields.slice(0, 2);
  for (const field of fields) {
    field.addEventListener("blur", fill);
    field.addEventListener("change", () => {
      if (!field.reportValidity()) return;
      if (!sides.includes(field)) drawing.setNumber(field.name, field.value === "" ? null : Number(field.value));
      else if (sides.every(({ value, validity }) => value && validity.valid)) drawing.resize(...sides.map(({ value }) => Number(value)));
    });
  }
  /** @type {HTMLElement} */
  const middle = root.querySelector(".middle");
  const board = mountBoard(middle, own);
  /** @type {HTMLElement} */
  const grid = middle.querySelector(".boards");
  Object.assign(grid, { id: "drawing", tabIndex: 0, ariaLabel: "Map: arrow keys move the cursor, Space or Enter paints", role: "application" });
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

  drawing.on("stroke", draw);
  drawing.on("end", changed);
  drawing.on("map", show);
  drawing.on("last", () => toast("A map needs a parcel. Move this one, or add another one first."));

  function draw() {
    const { map } = drawing;
    const [height, width] = [map.cells.length, map.cells[0].length];
    const [x, y] = map.start;
    const frames = [{ x, y, step: 0, done: false, delivered: [], target: null }];
    /** Only what the board reads. @type {any} */
    const start = { opening: { pilot: "" }, frames };
    const track = Object.assign(new Track(context, start), { colour: "--accent" });
    /** @type {any} */
    const world = { task: { short_name: "drawing", attribution: map.attribution }, seed: 0, width, height };
    stage.world = { ...world, cells: map.cells, parcels: map.parcels };
    stage.tracks = [track];
    board.reload();
    setText(document.getElementById("map-credit"), map.attribution);
    fill();
  }

  function fill() {
    const { map } = drawing;
    const drawn = map && { columns: map.cells[0].length, rows: map.cells.length, ...map.numbers };
    for (const field of fields) {
      field.disabled = map === null;
      if (document.activeElement !== field) field.value = drawn?.[field.name] ?? "";
      field.placeholder = worth?.numbers[field.name] ?? "";
    }
  }

  function changed() {
    remember(key, JSON.stringify(drawing.map), "sessionStorage");
    undo.disabled = !drawing.past.length;
    weigh();
  }

  function show() {
    draw();
    changed();
    stage.show(stage.world, stage.tracks);
    point();
  }

  /** Asks for the optimum of the present map: one request at a time, then one for the newest map. */
  async function weigh() {
    isStale = true;
    score.parentElement.classList.add("waiting");
    if (isAsking) return;
    for (isAsking = true; isStale && drawing.map; ) {
      isStale = false;
      const parcels = drawing.map.parcels.length;
      const answer = await api.post("maps/worth", drawing.map).catch((error) => error);
      if (!isStale) tell(answer instanceof Error ? null : answer, parcels, answer.message ?? null);
    }
    isAsking = false;
  }

  /** Shows an answer, or why there is none. */
  function tell(answer, parcels, wrong) {
    worth = answer;
    const best = answer?.optimum;
    score.parentElement.classList.remove("waiting");
    setText(score, best ? points(best.score) : "–");
    setText(note, answer ? inWords(best, parcels) : "");
    problem.hidden = wrong === null;
    setText(problem, wrong ?? "");
    for (const button of acts) button.disabled = wrong !== null;
    if (stage.track) {
      /** @type {any} */
      const annotation = best ? { optimum: best, moves: [] } : null;
      stage.track.annotation = annotation;
      board.refresh();
    }
    fill();
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
      wrong = error.message.replace("path.seed", "The number of the map");
    }
    // Meanwhile the visitor may have gone elsewhere, or begun an empty map.
    if (wanted !== keyOf(router.address) || isOpen()) return;
    become(wanted, found);
    if (wrong !== null) tell(null, 0, wrong);
  }

  function empty() {
    return { cells: drawing.empty(EMPTY, EMPTY), start: [0, 0], parcels: [[EMPTY - 1, EMPTY - 1]], numbers: {} };
  }

  function become(wanted, found) {
    [key, worth, isStale] = [wanted, null, true];
    drawing.become(found);
    point(null);
    if (found) show();
    else stage.show(null, []);
  }

  router.on("address", look);
  context.server.on("state", ({ state }) => state === "open" && !problem.hidden && (drawing.map ? weigh() : look()));
  look();
}

function inWords(optimum, parcels) {
  if (!optimum) return "This map is too large for the exact solver.";
  if (!optimum.success) return `At best ${optimum.deliveries} of ${parcels} parcels: the battery or the steps run out`;
  return `${["The parcel", "Both parcels"][parcels - 1] ?? `All ${parcels} parcels`} in ${counted(optimum.steps, "step")}`;
}
