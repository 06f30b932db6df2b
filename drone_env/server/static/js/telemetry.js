// The raw numbers for those who want them, and the files to take away: CSV of the flights, PNG of map and chart.
import { download, el, setText, toast } from "./dom.js";
import { fixed, points } from "./format.js";
import { colourOf, font } from "./palette.js";
import { recordOf } from "./past.js";

const COLUMNS = (
  "step action x y cell_below event reward reward_total battery battery_units deliveries_done distance score efficiency value " +
  "regret outcome message"
).split(" ");

/**
 * @param {HTMLElement} root @param {import("./context.js").Context} context
 * @param {{boards: () => import("./board.js").Board[], graph: HTMLCanvasElement}} drawn
 */
export function mountTelemetry(root, context, { boards, graph }) {
  const { stage } = context;
  const vector = el("p.telemetry-vector", { id: "telemetry" });
  const raw = el("pre.raw", { id: "raw-frame", tabindex: "0", "aria-label": "Frame as the server sent it" });
  const note = el("p.note", { text: "What the network is given beside the grid:" });
  const details = el("details.telemetry", el("summary", { text: "Raw telemetry" }), note, vector, raw);
  const button = (id, text, press) => el("button.button.quiet.small", { id, text, press });
  const record = button("save-record", "Record", saveRecord);
  const files = [button("save-csv", "CSV", saveCsv), button("save-png", "PNG", savePng), record];
  root.append(details, el("div.files", ...files));

  function draw() {
    root.hidden = !stage.frame;
    record.disabled = !stage.track?.record && !stage.track?.episode;
    if (!details.open || !stage.frame) return;
    setText(vector, stage.frame.telemetry.map((number) => fixed(number, 4)).join("   "));
    setText(raw, JSON.stringify(stage.frame, null, 1));
  }

  function saveCsv() {
    const { task, seed } = stage.world;
    const rows = stage.tracks.flatMap(({ by, frames }) =>
      frames.map((frame) => [by, task.id, seed, ...COLUMNS.map((name) => frame[name])].map(cell).join(",")),
    );
    const text = [["pilot", "task", "seed", ...COLUMNS].join(","), ...rows].join("\r\n");
    download(`${name()}.csv`, new Blob([`${text}\r\n`], { type: "text/csv" }));
  }

  async function saveRecord() {
    const text = `${JSON.stringify(await recordOf(context, stage.track), null, 2)}\n`;
    download(`${name()}.json`, new Blob([text], { type: "application/json" }));
  }

  function savePng() {
    sheet(boards(), graph, captions()).toBlob((blob) => {
      if (blob) download(`${name()}.png`, blob);
      else toast("The picture could not be made.");
    }, "image/png");
  }

  /** The flights as the name of a file. */
  function name() {
    const words = [stage.world.task.short_name, stage.world.seed, ...stage.tracks.map(({ by }) => by)];
    return words
      .join("-")
      .replace(/[^\w.-]+/g, "_")
      .slice(0, 100);
  }

  const captions = () =>
    stage.tracks.map((track) => {
      const frame = track.frameAt(stage.clock.cursor);
      const where = `${stage.world.task.id} · map ${stage.world.seed}`;
      return `${track.name} · ${where} · step ${frame.step} · score ${points(frame.score)}`;
    });

  details.addEventListener("toggle", draw);
  stage.on("change", draw);
}

function cell(value) {
  const text = value === null || value === undefined ? "" : String(value);
  return /[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}

/** All boards with what they show, and the graph below them. */
function sheet(boards, graph, captions) {
  const images = boards.map((board) => board.image());
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
  return canvas;
}
