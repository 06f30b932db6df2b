// The map in words: what a visitor who flies meets at each move, and where everything is.
import { announce, el } from "./dom.js";
import { cellName, counted } from "./format.js";
import { cellAt, inWords } from "./layer_costs.js";
import { STEP } from "./layer_flights.js";

const QUIET = new Set(["step", "wait", null]);

/** @param {HTMLElement} root @param {Context} context */
export function mountTextMap(root, context) {
  const { stage } = context;
  const list = el("dl.text-map");
  const details = el("details", { on: { toggle: write } }, el("summary.note", { text: "The map in words" }), list);
  root.append(details);
  let said = null;

  function write() {
    const { world, track, frame } = stage;
    if (!details.open || !frame) return;
    const places = placesOf(context, world, frame);
    const here = inWords(cellAt(world, context.names, frame, frame.x, frame.y));
    const rows = [[track.name, `column ${frame.x}, row ${frame.y}. ${here}`], ["Around it", around(context)], ...places];
    list.replaceChildren(...rows.map(([name, text]) => el("div", el("dt", { text: name }), el("dd", { text }))));
  }

  function say() {
    const { world, track } = stage;
    if (!track?.byHand || said === track.last) return;
    said = track.last;
    const { x, y, battery_units: units, event, message } = said;
    const news = QUIET.has(event) ? "" : `${message} `;
    announce(`${news}Column ${x}, row ${y}. Battery ${units} of ${world.battery_capacity}. ${around(context)}`);
  }

  stage.on("change", () => {
    write();
    // After the list of moves, which announces only what a move meets.
    queueMicrotask(say);
  });
}

/** The cells beside the drone: `Up: Road: costs 1 unit. Right: edge of the map. ...`. @param {Context} context */
function around({ stage: { world, frame }, names }) {
  const sides = Object.entries(STEP).map(([action, [dx, dy]]) => {
    const [x, y] = [frame.x + dx, frame.y + dy];
    const words = world.cells[y]?.[x] === undefined ? "edge of the map" : inWords(cellAt(world, names, frame, x, y));
    return `${cellName(action.toLowerCase())}: ${words}.`;
  });
  return sides.join(" ");
}

/** Where the parcels, the pads and the closed cells are. @param {Context} context */
function placesOf({ names }, world, { target, delivered }) {
  const gone = new Set(delivered.map(String));
  const at = (cells) => cells.map((cell) => `column ${cell[0]}, row ${cell[1]}`).join("; ") || "none";
  const of = (wanted) =>
    world.cells.map((row) => row.flatMap((id, x) => (wanted(names[id]) ? [x] : []))).map((columns, y) => ({ columns, y }));
  const pads = of((kind) => kind === "pad").flatMap(({ columns, y }) => columns.map((x) => [x, y]));
  const closed = of((kind) => world.task.impassable.includes(kind)).filter(({ columns }) => columns.length);
  const rows = closed.map(({ columns, y }) => `row ${y}: ${columns.length > 1 ? "columns" : "column"} ${ranges(columns)}`);
  const count = counted(closed.reduce((sum, { columns }) => sum + columns.length, 0), "cell");
  return [
    ["Target", target ? at([target]) : "none"],
    ["Parcels to deliver", at(world.parcels.filter((parcel) => !gone.has(String(parcel))))],
    ["Delivered", at(delivered)],
    ...(world.task.pads ? [["Pads", at(pads)]] : []),
    ...(rows.length ? [["Closed", `${count}. ${rows.join("; ")}`]] : []),
  ];
}

/** Numbers in words: `3, 7 to 9`. @param {number[]} numbers */
function ranges(numbers) {
  const starts = numbers.filter((n, i) => numbers[i - 1] !== n - 1);
  const ends = numbers.filter((n, i) => numbers[i + 1] !== n + 1);
  return starts.map((start, i) => (start === ends[i] ? start : `${start} to ${ends[i]}`)).join(", ");
}
