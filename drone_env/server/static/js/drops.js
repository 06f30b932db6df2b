// Files of flights: chosen, or dropped anywhere on the page.
import { el } from "./dom.js";

/** @param {HTMLElement} root @param {import("./past.js").Past} past @param {(flights: () => Promise<void>) => void} open */
export function mountFiles(root, past, open) {
  const input = el("input.visually-hidden", {
    type: "file",
    id: "flight-file",
    accept: ".json,.jsonl",
    on: {
      change: async () => {
        const [file] = input.files;
        if (file) await open(() => past.openFile(file));
        input.value = "";
      },
    },
  });
  const change = () => open(() => past.openRecord(flights.selectedIndex));
  const flights = el("select", { id: "flight-of-file", "aria-label": "Flight of the file", hidden: true, on: { change } });
  root.append(el("div.field", input, el("label.button.small", { for: "flight-file", text: "Open a file…" }), flights));

  let offered = past.records;
  past.context.stage.on("load", async () => {
    if (past.records === offered) return;
    offered = past.records;
    const { flightName } = await import("./names.js");
    flights.hidden = past.records.length < 2;
    flights.replaceChildren(...past.records.map((record, i) => el("option", { text: `${i + 1}. ${flightName(past.context, record)}` })));
  });
}

/** @param {(file: File) => void} open */
export function listenToDrops(open) {
  const hint = el("div.drop-hint", { hidden: true }, el("p", { text: "Drop the file to see its flights, or its map" }));
  document.body.append(hint);
  const hasFiles = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");
  document.addEventListener("dragover", (event) => {
    if (!hasFiles(event)) return;
    event.preventDefault();
    hint.hidden = false;
  });
  document.addEventListener("dragleave", (event) => {
    if (event.relatedTarget === null) hint.hidden = true;
  });
  document.addEventListener("drop", (event) => {
    hint.hidden = true;
    if (!hasFiles(event)) return;
    event.preventDefault();
    if (event.dataTransfer.files[0]) open(event.dataTransfer.files[0]);
  });
}
