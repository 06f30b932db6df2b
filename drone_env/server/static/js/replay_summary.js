// What a replayed flight came to, beside the optimum of its map.
import { el } from "./dom.js";
import { fixed, OUTCOMES, points, title } from "./format.js";

export class ReplaySummary {
  constructor() {
    this.title = el("h3.replay-title");
    this.facts = el("dl.facts");
    this.verdict = el("div.verdict", { id: "replay-verdict" });
    this.root = el("div.replay-summary", this.title, this.facts, this.verdict);
  }

  /** @param {object} mission @param {object} last The last frame. */
  show(mission, last) {
    this.title.textContent = `${title(mission.task)}, map ${mission.seed}, flown by ${mission.pilot}`;
    this.facts.replaceChildren(
      fact("Outcome", OUTCOMES[last.outcome] ?? last.outcome),
      fact("Parcels", `${last.deliveries_done} of ${mission.deliveries_total}`),
      fact("Steps", `${last.step} of ${mission.max_steps}`),
      fact("Score", points(last.score)),
      fact("Efficiency", fixed(last.efficiency, 1)),
    );
    this.verdict.replaceChildren();
  }

  /** @param {object} annotation As `POST /annotate` tells it. */
  annotated(annotation) {
    this.facts.append(
      fact("Optimum", `${points(annotation.optimal_score)} in ${annotation.optimal_steps} steps`),
      fact("Regret", points(annotation.regret)),
    );
  }

  unknown(why) {
    this.verdict.replaceChildren(el("p.note", { text: why }));
  }
}

const fact = (name, value) => el("div", el("dt", { text: name }), el("dd", { text: value }));
