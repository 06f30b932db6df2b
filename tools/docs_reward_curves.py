"""Train on `tiered` and on `aligned`, all else equal, and draw what comes of it: `python tools/docs_reward_curves.py`.

Writes docs/images/training/*.png and the table of docs/reward.md between its two markers; five minutes, with PyTorch.
"""

import dataclasses
import sys
from pathlib import Path

from drone_env.rl.config import preset
from drone_env.rl.curves import draw_curves
from drone_env.rl.trainer import Progress, Trainer

DOCS = Path(__file__).parents[1] / "docs"
TASK = "easy"
EPISODES = 1_500
"""Enough to see which way each goes."""
REWARDS = ("tiered", "aligned")
BEGIN, END = "<!-- curves: written by reward_curves.py -->", "<!-- end of curves -->"


def main() -> None:
    """Train, draw, write."""
    histories: dict[str, list[Progress]] = {}
    rows = [
        "| trained on | reward of the last episodes | steps | delivered | its score on validation maps | optimum |",
        "|---|---|---|---|---|---|",
    ]
    for reward in REWARDS:
        trainer = Trainer(dataclasses.replace(preset("fast", TASK), reward_profile=reward, episodes=EPISODES))
        for _ in trainer.train():
            pass
        last = trainer.history[-1]
        histories[reward] = trainer.history
        rows.append(
            f"| `{reward}` | {last.reward:.2f} | {last.length:.1f} | {last.success:.1%} "
            f"| {last.validation:.4f} | {last.validation_optimum:.4f} |"
        )
        print(rows[-1], file=sys.stderr)
    draw_curves(histories, TASK, DOCS / "images" / "training")
    page = DOCS / "reward.md"
    before, rest = page.read_text(encoding="utf-8").split(BEGIN)
    after = rest.split(END)[1]
    page.write_text(f"{before}{BEGIN}\n\n" + "\n".join(rows) + f"\n\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
