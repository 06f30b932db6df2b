// The raw numbers for those who want them, and the files to take away: CSV of the flights, PNG of map and chart.
import { download, el, setText, toast } from "./dom.js";
import { fixed } from "./format.js";
import { nextFrame } from "./loop.js";
import { palette } from "./palette.js";

const COLUMNS = [
  "step",
  "action",
  "x",
  "y",
  "cell_below",
  "event",
  "reward",
  "reward_total",
  "battery",
  "battery_units",
  "deliveries_done",
  "distance",
  "score",
  "efficiency",
  "value",
  "regret",
  "outcome",
  "message",
];

/** @param {HTMLElement} root @param {import("./context.js").Context} context @param {import("./fleet.js").Fleet} fleet */
export function mountTelemetry(root, context, fleet, { maps, charts }) {
  const { player } = context;
  const vector = el("p.telemetry-vector", { id: "telemetry" });
  const raw = el("pre.raw", { id: "raw-frame", tabindex: "0", "aria-label": "Frame as the server sent it" });
  const details = el(
    "details.telemetry",
    el("summary", { text: "Raw telemetry" }),
    el("p.note", { text: "What the network is given beside the grid:" }),
    vector,
    raw,
  );
  const files = el(
    "div.files",
    el("button.button.quiet.small", { id: "save-csv", text: "CSV", press: saveCsv }),
    el("button.button.quiet.small", { id: "save-png", text: "Map PNG", press: savePng }),
  );
  root.append(details, files);

  function draw() {
    if (!details.open || !player.frame) return;
    setText(vector, player.frame.telemetry.map((number) => fixed(number, 4)).join("   "));
    setText(raw, JSON.stringify(player.frame, null, 1));
  }

  function saveCsv() {
    if (!fleet.active.length) return;
    const rows = fleet.active.flatMap(({ mission, frames }) =>
      frames.map((frame) =>
        [mission.pilot, mission.task, mission.seed, ...COLUMNS.map((name) => frame[name])].map(cell).join(","),
      ),
    );
    const text = [["pilot", "task", "seed", ...COLUMNS].join(","), ...rows].join("\r\n");
    download(`${name()}.csv`, new Blob([`${text}\r\n`], { type: "text/csv" }));
  }

  function savePng() {
    if (!fleet.active.length) return;
    sheet(maps(), charts(), caption()).toBlob((blob) => {
      if (blob) download(`${name()}.png`, blob);
      else toast("The picture could not be made.");
    }, "image/png");
  }

  const name = () => `${fleet.setup.task}-${fleet.setup.seed}-${fleet.setup.pilots.join("-")}`;
  const caption = () =>
    fleet.active.map(
      ({ mission, frame }) =>
        `${fleet.pilot(mission.pilot).name} · ${mission.task} · map ${mission.seed} · step ${frame.step} · score ${fixed(frame.score * 100, 1)}`,
    );

  details.addEventListener("toggle", draw);
  player.on("change", () => nextFrame(draw));
}

function cell(value) {
  const text = value === null || value === undefined ? "" : String(value);
  return /[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}

/** All maps with what they are, and the charts below them. */
function sheet(maps, charts, captions) {
  const colours = palette();
  const images = maps.map((map) => map.image());
  const columns = images.length > 1 ? 2 : 1;
  const rows = Math.ceil(images.length / columns);
  const scale = window.devicePixelRatio || 1;
  const head = 28 * scale;
  const width = Math.max(images[0].width * columns, ...charts.map((chart) => chart.width));
  const height = rows * (images[0].height + head);
  const gap = 8 * scale;
  const canvas = el("canvas", { width, height: charts.reduce((sum, chart) => sum + chart.height + gap, height + gap) });
  const ctx = canvas.getContext("2d");
  ctx.fillStyle = colours.ground;
  ctx.fillRect(0, 0, canvas.width, canvas.height);
  ctx.fillStyle = colours.ink;
  ctx.textBaseline = "middle";
  ctx.font = `500 ${13 * scale}px ${colours.font}`;
  images.forEach((image, i) => {
    const x = (i % columns) * image.width + Math.round((width - columns * image.width) / 2);
    const y = Math.floor(i / columns) * (image.height + head);
    ctx.fillText(captions[i], x + 12 * scale, y + head / 2, image.width - 24 * scale);
    ctx.drawImage(image, x, y + head);
  });
  let y = height + gap;
  for (const chart of charts) {
    ctx.drawImage(chart, Math.round((width - chart.width) / 2), y);
    y += chart.height + gap;
  }
  return canvas;
}
