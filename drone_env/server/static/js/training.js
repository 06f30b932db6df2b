// The curves of the newest training, as it goes.
import { Chart } from "./charts.js";
import { el } from "./dom.js";
import { fixed, percent, points, title } from "./format.js";

/** What is drawn where the training tells it, and how it is written; the reward comes last. */
const DRAWN = {
  validation: ["Score on the validation maps", points],
  success: ["Success", percent],
  regret: ["Lost by a choice", points],
  loss: ["Loss", (v) => fixed(v, 4)],
  reward: ["Reward", fixed],
};

export class Training {
  /** @param {HTMLElement} root @param {import("./context.js").Context} context */
  constructor(root, context) {
    this.context = context;
    this.charts = new Map();
    this.body = el("div.charts");
    this.root = el("section.compare-part", { hidden: true }, el("h2", { text: "Newest training" }), this.body);
    root.append(this.root);
  }

  /** @param {Object<string, (number|null)[]>} curve As `/live` tells it; its first figure counts. */
  show(curve) {
    const [count] = Object.keys(curve);
    this.root.hidden = count === undefined;
    for (const [name, [words, write]] of Object.entries(DRAWN)) {
      const drawn = curve[name];
      if (drawn && !this.charts.has(name)) {
        const labels = { title: words, x: title(count), y: words };
        const options = { ...labels, file: name, kind: "line", format: (v) => write(v) };
        this.charts.set(name, new Chart(this.body, this.context, options));
      }
      const chart = this.charts.get(name);
      if (!chart) continue;
      chart.root.hidden = !drawn;
      const last = drawn?.at(-1);
      const optimum = name === "validation" && curve.optimum?.at(-1);
      const best = optimum ? ` The optimum of these maps: ${write(optimum)}.` : "";
      if (drawn) chart.show(drawn, `${write(last)} at ${count} ${curve[count].at(-1)}.${best}`, curve[count]);
    }
  }
}
