// The raw numbers of the step that is shown, and the flights as files: CSV of their frames, the record.
import { download, el, setText, toast } from "./dom.js";
import { recordOf } from "./past.js";

const COLUMNS = (
  "step action x y cell_below event reward reward_total battery battery_units deliveries_done distance score efficiency value " +
  "regret outcome message"
).split(" ");

/** @param {HTMLElement} root @param {import("./context.js").Context} context */
export function mountTelemetry(root, context) {
  const { stage } = context;
  const raw = el("pre.raw", { id: "raw-frame", tabindex: "0", "aria-label": "Frame as the server sent it" });
  const details = el("details.telemetry", el("summary", { text: "Raw telemetry" }), raw);
  const button = (id, text, press) => el("button.button.quiet.small", { id, text, press });
  const record = button("save-record", "Record", () => saveRecord(context));
  root.append(details, el("div.files", button("save-csv", "CSV", () => saveTable(stage)), record));

  function draw() {
    root.hidden = !stage.frame;
    record.disabled = !stage.track?.record && !stage.track?.episode;
    if (!details.open || !stage.frame) return;
    setText(raw, JSON.stringify(stage.frame, null, 1));
  }

  details.addEventListener("toggle", draw);
  stage.on("change", draw);
}

function saveTable(stage) {
  const { task, seed } = stage.world;
  const rows = stage.tracks.flatMap(({ by, frames }) =>
    frames.map((frame) => [by, task.id, seed, ...COLUMNS.map((name) => frame[name])].map(cell).join(",")),
  );
  const text = [["pilot", "task", "seed", ...COLUMNS].join(","), ...rows].join("\r\n");
  download(`${name(stage)}.csv`, new Blob([`${text}\r\n`], { type: "text/csv" }));
}

async function saveRecord(context) {
  try {
    const text = `${JSON.stringify(await recordOf(context, context.stage.track), null, 2)}\n`;
    download(`${name(context.stage)}.json`, new Blob([text], { type: "application/json" }));
  } catch (error) {
    toast(`The file could not be made: ${error.message}`);
  }
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
