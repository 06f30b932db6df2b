"""The page of each environment, with a film, from the registry: `make docs` adds them to the site.

Tasks of your own get pages too: `DRONE_ENV_PLUGINS=my_module make docs`.
"""

import inspect
from collections.abc import Iterator
from contextlib import suppress
from io import BytesIO
from typing import Any

import numpy as np
from docs_tables import numbers_of, scores_of
from docstring_parser import parse
from PIL import Image

from drone_env.agents import make_agent
from drone_env.agents.base import begin
from drone_env.core.actions import Action
from drone_env.core.episode import Episode, rollout
from drone_env.core.rewards import DEFAULT_PROFILE, REWARD_PROFILES
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.datasets.build import columns
from drone_env.envs.drone_delivery import DroneDeliveryEnv
from drone_env.envs.registry import load_plugins, plugin_names
from drone_env.envs.rendering import draw_picture
from drone_env.errors import TooLargeError, UnsupportedTaskError
from drone_env.results.tables import markdown

FOLDER = "environments"
FLOWN = {"optimal": "the optimum", "tournet": "tournet"}
"""The agents of a film from left to right, and their names in its caption."""
PIXELS, PICTURES, COLOURS = 320, 32, 64
"""Height of a film, its maximum number of pictures, and its colours: few, so that it is small."""
FRAME_MS, END_MS = 200, 2000

DOCUMENTED = parse(inspect.getdoc(DroneDeliveryEnv) or "")

PAGE = """# {title}

![{caption}]({task.short_name}.webp)

The first test map. {caption}.

| Import | `gymnasium.make("{module}:{task.gym_id}")` |
|---|---|
| Action space | `{env.action_space}` |
| Observation space | `{env.observation_space}` |
| Task, grader | `{task.id}`, `{task.grader}` |

## Description

Every map is drawn from its seed{source}. The [rules](../rules.md) are those of all tasks; the numbers are its own:

{numbers}

## Actions

{actions}

## Observations

{observation}

The grid is indexed `[y, x]`; all telemetry is from 0 to 1.

## Rewards

The argument `reward_profile` chooses [the reward](../reward.md), `{default_profile}` by default.

{rewards}

## Start, end and score

`reset(seed=s)` starts on map `s` with a full battery. The episode ends when all parcels are delivered, when the battery
is empty, and after {task.max_steps} steps. It is then `terminated`, never `truncated`. [The score](../rules.md#score)
grades the whole flight.

## Information

{information}

## Arguments

{arguments}

## Scores

{scores}

## Versions

Version {task.version} has the rules `{task.digest}`. A change of maps, rewards, scores or observations raises it.
"""


def title(task: TaskConfig) -> str:
    """The title of its page."""
    return task.short_name.replace("_", " ").title()


def flights(task: TaskConfig) -> Iterator[tuple[str, Episode]]:
    """Fly the first test map with the agents of a film that support the task."""
    for agent in FLOWN:
        with suppress(UnsupportedTaskError, TooLargeError):
            episode = Episode(task, seed=split_seeds("test", 1)[0])
            yield agent, rollout(episode, begin(make_agent(agent, task), agent, episode))


def film(flown: list[Episode]) -> bytes:
    """The flights side by side as a WebP. The shorter one waits for the longer at its end."""
    steps = max(episode.steps for episode in flown)
    every = -(-steps // (PICTURES - 1))
    again = [Episode(episode.task, seed=episode.seed) for episode in flown]
    pictures: list[Image.Image] = []
    for step in range(0, steps + every, every):
        for episode, copy in zip(flown, again, strict=True):
            copy.fly(episode.actions[copy.steps : step])
        pictures.append(Image.fromarray(np.hstack([draw_picture(copy, PIXELS) for copy in again])))
    # Parcels before and after delivery.
    both_ends = Image.fromarray(np.vstack([np.asarray(pictures[0]), np.asarray(pictures[-1])]))
    palette = both_ends.quantize(COLOURS, Image.Quantize.MEDIANCUT)
    first, *rest = (one.quantize(palette=palette, dither=Image.Dither.NONE).convert("RGB") for one in pictures)
    options: dict[str, Any] = {"duration": [FRAME_MS] * len(rest) + [END_MS], "loop": 0}
    file = BytesIO()
    first.save(file, "WEBP", save_all=True, append_images=rest, lossless=True, method=4, minimize_size=True, **options)
    return file.getvalue()


def arguments() -> str:
    """The arguments of `gymnasium.make`; the id contains task and version."""
    defaults, rows = inspect.signature(DroneDeliveryEnv).parameters, [["argument", "default", ""]]
    for one in DOCUMENTED.params:
        if one.arg_name not in ("task", "version"):
            meaning = " ".join((one.description or "").split())
            rows.append([f"`{one.arg_name}`", f"`{defaults[one.arg_name].default!r}`", meaning])
    return markdown(rows)


def observation(task: TaskConfig) -> str:
    """The parts of an observation."""
    seen = {column.name: column.text for column in columns(task)}
    grid, telemetry = f"uint8[{task.height}, {task.width}]", f"float32[{task.telemetry_size}]"
    rows = [["key", "type", "values"], ["`grid`", grid, seen["grid"]], ["`telemetry`", telemetry, seen["telemetry"]]]
    return markdown(rows)


def page(task: TaskConfig, flown: dict[str, Episode]) -> str:
    """The page of a task in Markdown."""
    env, modules = DroneDeliveryEnv(task), [name for name in plugin_names() if not name.endswith(".toml")]
    ends = [f"{FLOWN[agent]}, score {one.score:.4f} after {one.steps} steps" for agent, one in flown.items()]
    return PAGE.format(
        task=task,
        module="drone_env" if scores_of(task) or not modules else modules[0],
        env=env,
        title=title(task),
        caption="; ".join(map(": ".join, zip(("Left", "right"), ends, strict=False))),
        source=task.attribution and f", over real streets ({task.attribution})",
        numbers=markdown([["number", "value"], *numbers_of(task).items()]),
        actions=markdown([["action", "name"], *((str(int(action)), action.name) for action in Action)]),
        observation=observation(task),
        default_profile=DEFAULT_PROFILE,
        rewards=markdown([["profile", "reward"], *((f"`{one.id}`", one.summary) for one in REWARD_PROFILES.values())]),
        information=(DOCUMENTED.long_description or "").split("\n\n")[-1],
        arguments=arguments(),
        scores=scores_of(task) or f"Fly it: `drone-env evaluate --task {task.short_name}`.",
    )


def site_files() -> dict[str, str | bytes]:
    """All pages and films by their path on the site, each page before its film."""
    load_plugins()
    files: dict[str, str | bytes] = {}
    for task in TASKS.values():
        flown = dict(flights(task))
        files[f"{FOLDER}/{task.short_name}.md"] = page(task, flown)
        files[f"{FOLDER}/{task.short_name}.webp"] = film([*flown.values()])
    return files
