// The raw numbers for those who want them, and the files to take away: CSV of the flights, PNG of map and chart.
import { el, setText, toast } from "./dom.js";
import { fixed } from "./format.js";

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
  /** Makes one of the files, and hands it to the visitor. */
  const save = (what) => async () => {
    try {
      const saved = await import("./saved.js");
      await saved[what](context, boards(), graph);
    } catch (error) {
      toast(`The file could not be made: ${error.message}`);
    }
  };
  const record = button("save-record", "Record", save("record"));
  const files = [button("save-csv", "CSV", save("csv")), button("save-png", "PNG", save("png")), record];
  root.append(details, el("div.files", ...files));

  function draw() {
    root.hidden = !stage.frame;
    record.disabled = !stage.track?.record && !stage.track?.episode;
    if (!details.open || !stage.frame) return;
    setText(vector, stage.frame.telemetry.map((number) => fixed(number, 4)).join("   "));
    setText(raw, JSON.stringify(stage.frame, null, 1));
  }

  details.addEventListener("toggle", draw);
  stage.on("change", draw);
}
