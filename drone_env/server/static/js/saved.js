// Flights as files to take away: CSV of their frames, PNG of map and chart, the record.
import { download, el } from "./dom.js";
import { points } from "./format.js";
import { colourOf, font } from "./palette.js";
import { recordOf } from "./past.js";

const COLUMNS = (
  "step action x y cell_below event reward reward_total battery battery_units deliveries_done distance score efficiency value " +
  "regret outcome message"
).split(" ");

/** @param {import("./context.js").Context} context */
export function csv({ stage }) {
  const { task, seed } = stage.world;
  const rows = stage.tracks.flatMap(({ by, frames }) =>
    frames.map((frame) => [by, task.id, seed, ...COLUMNS.map((name) => frame[name])].map(cell).join(",")),
  );
  const text = [["pilot", "task", "seed", ...COLUMNS].join(","), ...rows].join("\r\n");
  download(`${name(stage)}.csv`, new Blob([`${text}\r\n`], { type: "text/csv" }));
}

export async function record(context) {
  const text = `${JSON.stringify(await recordOf(context, context.stage.track), null, 2)}\n`;
  download(`${name(context.stage)}.json`, new Blob([text], { type: "application/json" }));
}

/** @param {import("./board.js").Board[]} boards @param {HTMLCanvasElement} graph */
export async function png({ stage }, boards, graph) {
  const captions = stage.tracks.map((track) => {
    const frame = track.frameAt(stage.clock.cursor);
    const where = `${stage.world.task.id} · map ${stage.world.seed}`;
    return `${track.name} · ${where} · step ${frame.step} · score ${points(frame.score)}`;
  });
  download(`${name(stage)}.png`, await sheet(boards, graph, captions));
}

/** The flights as the name of a file. */
function name({ world, tracks }) {
  const words = [world.task.short_name, world.seed, ...tracks.map(({ by }) => by)];
  return words
    .join("-")
    .replace(/[^\w.-]+/g, "_")
    .slice(0, 100);
}

function cell(value) {
  const text = value === null || value === undefined ? "" : String(value);
  return /[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}

/** All boards with what they show, and the graph below them. @returns {Promise<Blob>} */
function sheet(boards, graph, captions) {
  const images = boards.map(image);
  const columns = images.length > 1 ? 2 : 1;
  const rows = Math.ceil(images.length / columns);
  const scale = window.devicePixelRatio || 1;
  const head = 28 * scale;
  const width = Math.max(images[0].width * columns, graph.width);
  const height = rows * (images[0].height + head) + 8 * scale;
  const canvas = el("canvas", { width, height: height + graph.height + 8 * scale });
  const ctx = canvas.getContext("2d");
  ctx.fillStyle = colourOf("--ground");
  ctx.fillRect(0, 0, canvas.width, canvas.height);
  ctx.fillStyle = colourOf("--ink");
  ctx.textBaseline = "middle";
  ctx.font = font(13 * scale);
  images.forEach((image, i) => {
    const x = (i % columns) * image.width + Math.round((width - columns * image.width) / 2);
    const y = Math.floor(i / columns) * (image.height + head);
    ctx.fillText(images.length > 1 ? captions[i] : captions.join("  |  "), x + 12 * scale, y + head / 2, image.width - 24 * scale);
    ctx.drawImage(image, x, y + head);
  });
  ctx.drawImage(graph, Math.round((width - graph.width) / 2), height);
  return new Promise((resolve, reject) =>
    canvas.toBlob((blob) => (blob ? resolve(blob) : reject(new Error(`${canvas.width} by ${canvas.height} pixels`)))),
  );
}

/** The map as it stands, as an image of its own. @returns {HTMLCanvasElement} */
function image({ canvases, stage, size: { scale } }) {
  const [, , air] = canvases;
  const canvas = el("canvas", { width: air.width, height: air.height });
  const ctx = canvas.getContext("2d");
  ctx.fillStyle = colourOf("--ground");
  ctx.fillRect(0, 0, canvas.width, canvas.height);
  for (const one of canvases) if (one.width && !one.matches(".waiting")) ctx.drawImage(one, ...(one.at ?? [0, 0]));
  const { attribution } = stage.world.task;
  if (!attribution) return canvas;
  ctx.font = font(11 * scale);
  const wide = ctx.measureText(attribution).width + 8 * scale;
  ctx.fillStyle = colourOf("--ground");
  ctx.fillRect(0, canvas.height - 16 * scale, wide, 16 * scale);
  ctx.fillStyle = colourOf("--ink-2");
  ctx.fillText(attribution, 4 * scale, canvas.height - 4 * scale);
  return canvas;
}
