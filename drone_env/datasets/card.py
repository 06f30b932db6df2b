"""The page that lies beside a data set and says what it holds."""

import json

from drone_env.datasets.columns import columns
from drone_env.datasets.config import DatasetConfig
from drone_env.datasets.minari_writer import FOLDER, dataset_id
from drone_env.datasets.parquet_writer import FILE


def card(config: DatasetConfig, formats: tuple[str, ...], rows: int) -> str:
    """The page, as Markdown with the front matter that data set hubs read."""
    task, seeds = config.task, config.seeds
    about = config.as_json()
    parts = [
        "---",
        "license: mit",
        f"pretty_name: Drone Delivery, {task.id}, with exact values",
        "tags: [reinforcement-learning, imitation-learning, offline-rl, process-rewards]",
        "---",
        "",
        f"# Drone Delivery, {task.id} v{task.version}: steps with their exact values",
        "",
        f"{rows:,} steps of {config.episodes:,} flights: each of {', '.join(config.agents)} over {len(seeds):,} maps "
        f"of the split {config.split}, seeds {seeds.start} to {seeds.stop - 1}. With probability {config.epsilon:g} a "
        f"step flies a uniformly random action instead of the agent's. Rewards: profile `{config.reward_profile}`.",
        "",
        "V*(s) is the highest graded score (0.01 to 0.99) that can still be reached from a state, Q*(s, a) the highest "
        "after an action: exact, found by dynamic programming over every state of the map. Q*(s, a) is V* of the next "
        "state to the last bit, so the losses V*(s) - V*(s') of a flight add up to the optimum minus its score. They "
        "are in score, undiscounted, and do not depend on the reward profile.",
        "",
    ]
    if "parquet" in formats:
        parts += [
            f"## `{FILE}`",
            "",
            "One row per step, flight after flight, step after step. A state after which nothing is flown has no row. "
            "Arrays are stored flat, row by row; the shape stands here and in the metadata of the field.",
            "",
            "| column | type | shape | what it holds |",
            "|---|---|---|---|",
            "| `episode` | int64 | - | number of the flight, from 0 |",
            *(f"| `{c.name}` | {c.dtype} | {' x '.join(map(str, c.shape)) or '-'} | {c.text} |" for c in columns(task)),
            "",
            "Scores and values are graded scores, 0.01 to 0.99; shares are 0 to 1; everything else is a count, a "
            "number or a name.",
            "",
        ]
    if "minari" in formats:
        parts += [
            f"## `{FOLDER}/{dataset_id(config)}`",
            "",
            "The same flights for Minari, with all T + 1 observations of each:",
            "",
            "```python",
            "import os",
            "",
            f'os.environ["MINARI_DATASETS_PATH"] = "{FOLDER}"  # this folder\'s; Minari takes no path of its own',
            "import minari",
            "",
            f'dataset = minari.load_dataset("{dataset_id(config)}")',
            'print(dataset[0].infos["q_values"])',
            "```",
            "",
            "`infos` holds `action_mask`, `score`, `event` (a number: see `drone_env.core.actions.Event`), `value`, "
            "`q_values`, `regret`, `optimal_actions` and `agent_action`, one entry for each observation; of the last "
            "observation, after which nothing is flown, what tells of an action is NaN, False or -1. The metadata of "
            "each episode holds `seed`, `agent`, `final_score` and `optimal_score`.",
            "",
        ]
    parts += [
        "## Made by",
        "",
        "drone-env; the same configuration gives the same rows. It also stands in the metadata of the files, under "
        "`drone_env`.",
        "",
        "```json",
        json.dumps(about, indent=2),
        "```",
        "",
        "MIT licence.",
        "",
    ]
    return "\n".join(parts)
