"""The log lines of a flight: `[START]`, one `[STEP]` per step, `[END]`.

    [START] task=drone_env.graders:grade_easy env=drone_env_v1 model=greedy
    [STEP] step=1 action=LEFT reward=0.15 done=false error=null
    [STEP] step=2 action=UP reward=0.15 done=false error=null
    [STEP] step=3 action=UP reward=0.99 done=true error=null
    [END] success=true steps=3 score=0.990 rewards=0.15,0.15,0.99

Rewards have two decimals, the score three. `success` means that every parcel was delivered.
"""

from collections.abc import Sequence

from drone_env.core.actions import Action
from drone_env.core.tasks import TaskConfig

ENV_NAME = "drone_env_v1"


def start_line(task: TaskConfig, model: str) -> str:
    """Return the line before the first step; `model` is the name of the pilot."""
    return f"[START] task={task.grader} env={ENV_NAME} model={model}"


def step_line(step: int, action: Action, reward: float, done: bool, error: str | None = None) -> str:
    """Return the line of one step, counted from 1; `error` is null if the step succeeded."""
    return f"[STEP] step={step} action={action.name} reward={reward:.2f} done={_flag(done)} error={error or 'null'}"


def end_line(success: bool, score: float, rewards: Sequence[float]) -> str:
    """Return the line after the last step."""
    listed = ",".join(f"{reward:.2f}" for reward in rewards)
    return f"[END] success={_flag(success)} steps={len(rewards)} score={score:.3f} rewards={listed}"


def _flag(value: bool) -> str:
    return "true" if value else "false"
