"""An episode as text: its map for terminals and language models, and its log lines.

    [START] task=drone_env.graders:grade_easy env=drone_env_v1 model=greedy
    [STEP] step=1 action=LEFT reward=0.15 done=false error=null
    [STEP] step=2 action=UP reward=0.15 done=false error=null
    [STEP] step=3 action=UP reward=0.99 done=true error=null
    [END] success=true steps=3 score=0.990 rewards=0.15,0.15,0.99

Rewards have two decimals, the score three. `success` means that every parcel was delivered.
"""

from collections.abc import Sequence

from drone_env.core.actions import Action
from drone_env.core.cells import SYMBOLS, TARGET, Cell
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig

ENV_NAME = "drone_env_v1"
ROAD = SYMBOLS[Cell.ROAD]
WAY = "• "


def draw_text(episode: Episode) -> str:
    """The episode as lines of text: the grid, a status line, the last message.

    Args:
        episode: A started episode; it is not changed.

    Returns:
        `height` lines of the grid, row 0 first, two terminal columns per cell; then one line with task, seed, steps,
        battery units, deliveries and score x 100; then the message. The current target is 🎯. There are no colour
        codes and no newline at the end.

    Raises:
        EpisodeError: before the first reset.
    """
    task = episode.task
    status = (
        task.id,
        f"map {episode.seed}",
        f"step {episode.steps}/{task.max_steps}",
        f"battery {episode.battery_units}/{task.battery_capacity}",
        f"delivered {episode.deliveries_done}/{task.deliveries}",
        f"score {100 * episode.score:.1f}/100",
    )
    rows = _symbols(episode)
    if episode.target is not None:
        x, y = episode.target
        rows[y][x] = TARGET
    return "\n".join([*("".join(row) for row in rows), " · ".join(status), episode.message])


def draw_tour(episode: Episode, path: Sequence[tuple[int, int]], stops: Sequence[tuple[int, int]]) -> str:
    """The grid with a flight drawn over it.

    Args:
        episode: A started episode; it is not changed.
        path: (x, y) of the cells of the flight; roads among them become dots.
        stops: (x, y) of the parcels in the order of delivery; they become numbers from 1.

    Raises:
        EpisodeError: before the first reset.
    """
    rows = _symbols(episode)
    for x, y in path:
        if rows[y][x] == ROAD:
            rows[y][x] = WAY
    for number, (x, y) in enumerate(stops, start=1):
        rows[y][x] = f"{number:<2}"
    return "\n".join("".join(row) for row in rows)


def _symbols(episode: Episode) -> list[list[str]]:
    return [[SYMBOLS[kind] for kind in row] for row in episode.grid().tolist()]


def start_line(task: TaskConfig, model: str) -> str:
    """Return the line before the first step; `model` is the name of the pilot."""
    return f"[START] task={task.grader} env={ENV_NAME} model={model}"


def step_line(step: int, action: Action, reward: float, done: bool, error: str | None = None) -> str:
    """Return the line of one step, counted from 1; `error` is null if the step succeeded."""
    return (
        f"[STEP] step={step} action={action.name} reward={reward:.2f} done={str(done).lower()} error={error or 'null'}"
    )


def end_line(success: bool, score: float | None, rewards: Sequence[float]) -> str:
    """Return the line after the last step; the score is null if it is None."""
    listed, shown = ",".join(f"{reward:.2f}" for reward in rewards), "null" if score is None else f"{score:.3f}"
    return f"[END] success={str(success).lower()} steps={len(rewards)} score={shown} rewards={listed}"
