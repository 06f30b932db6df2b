// Draw: a map editor. The server computes the optimum, stores the map as a task and writes its file.
import { ApiError, tried } from "./api.js";
import { Emitter, recall, remember } from "./base.js";
import { mountBoards } from "./boards.js";
import { Camera } from "./camera.js";
import { add } from "./context.js";
import { download, el, icon, setText, toast } from "./dom.js";
import { Drawing } from "./drawing.js";
import { mountInput } from "./editor_input.js";
import { Worth } from "./editor_worth.js";
import { cellName } from "./format.js";
import { goneFrom, MAP, openField } from "./history.js";
import { drawSign } from "./legend.js";
import { copyLink } from "./router.js";
import { Stage } from "./stage.js";
import { Track } from "./track.js";

const SIDES = [2, 128];
const EMPTY = 12;
const SHOWN = new Set(["city", "signs", "best", "parcels", "drones"]);
const PALETTE = ["move", "road", "building", "tree", "obstacle", "pad", "parcel", "start"];
const NUMBERS = { battery_capacity: ["Battery", 1], max_steps: ["Steps", 1], charge_rate: ["Charge per wait", 0] };
const MOVE = "M12 3v18M3 12h18M9 6l3-3 3 3M9 18l3 3 3-3M6 9l-3 3 3 3M18 9l3 3-3 3";

/** Where this tab keeps the drawing of an address: Back and Reload restore it. @param {Partial<Address>} address */
const keyOf = ({ file, task, seed }) => `${MAP} ${file ?? `${task ?? ""} ${seed ?? 0}`}`;
const keep = (key, map) => remember(key, JSON.stringify(map), "sessionStorage");

/** @param {HTMLElement} root @param {Context} context */
export function mount(root, context) {
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
  const worth = new Worth(context, drawing);
  let key = null;

  const tools = el("fieldset.choice.palette", el("legend", { text: "Paint" }), ...PALETTE.map(choice));
  const undoing = el("button.button.small", { text: "Undo", title: "Undo (Ctrl Z)", press: () => drawing.undo() });
  const clear = () => (isOpen() ? drawing.edit(() => (drawing.map = empty())) : become(keyOf(router.address), empty()));
  const blank = el("button.button.small", { text: "Empty map", press: clear });
  const fields = Object.entries(NUMBERS).map(([name, [text, min]]) => field(name, text, min, 32_000, () => setNumber(name)));
  const sides = ["Columns", "Rows"].map((text) => field(text.toLowerCase(), text, ...SIDES, resize));
  const numbers = el("div.draw-numbers", ...[...sides, ...fields].map(({ label }) => label));
  const opening = el("div.field", ...openField(context, "map-file", toast));
  const about = el("p.note", { text: "Drawn maps use the Skyline rules." });
  const keys = el("p.note.keys-note", { text: "On the map, the arrow keys move a cursor and Space paints. 1 to 8 choose what." });
  const credit = el("p.note");
  const act = (id, text, press, tag = "button.button") => el(tag, { id, text, press: () => tried(press) });
  const acts = el(
    "div.draw-acts",
    act("fly-map", "Fly it", async () => router.go(await stored()), "button.button.primary"),
    act("race-map", "Race", async () => router.go(await stored(true))),
    act("link-map", "Copy link", async () => copyLink(await stored())),
    act("save-map", "Save file", save),
  );
  const middle = el("div.middle");
  root.append(
    el("aside.draw-tools", { "aria-label": "Tools" }, tools, el("div.row", undoing, blank), keys),
    middle,
    el(
      "aside.draw-side",
      { "aria-label": "The map" },
      worth.root,
      worth.problem,
      acts,
      numbers,
      opening,
      about,
      credit,
    ),
  );
  root.classList.add("draw");
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

  function field(id, text, min, max, change) {
    const input = el("input.input", { id: `map-${id}`, type: "number", min, max, step: "1", on: { change, blur: fill } });
    return { id, input, label: el("label", el("span", { text }), input) };
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

  function setNumber(name) {
    const { input } = fields.find(({ id }) => id === name);
    if (input.reportValidity()) drawing.setNumber(name, input.value === "" ? null : Number(input.value));
  }

  function resize() {
    if (!sides.every(({ input }) => input.value && input.reportValidity())) return;
    drawing.resize(...sides.map(({ input }) => Number(input.value)));
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
    setText(credit, map.attribution);
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
    for (const button of acts.querySelectorAll("button")) button.disabled = wrong !== null;
    drawBest();
  });

  function fill() {
    const { map } = drawing;
    const numbers = map && { columns: map.cells[0].length, rows: map.cells.length, ...map.numbers };
    for (const { id, input } of [...sides, ...fields]) {
      input.disabled = map === null;
      if (document.activeElement !== input) input.value = numbers?.[id] ?? "";
      input.placeholder = worth.answer?.numbers[id] ?? "";
    }
  }

  function changed() {
    draw();
    // Stored once per stroke: storage is slow.
    if (!drawing.stroke) keep(key, drawing.map);
    worth.ask();
  }

  /** Stores the map; the address where the visitor flies it, in a race with all others who can. */
  async function stored(race = false) {
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

  const isNumber = (target) => target instanceof HTMLInputElement && target.type === "number";
  document.addEventListener("keydown", (event) => {
    const undoes = (event.ctrlKey || event.metaKey) && event.key === "z";
    if (!undoes || context.view !== "draw" || isNumber(event.target)) return;
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
