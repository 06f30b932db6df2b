"""A data set as Minari keeps it: whole episodes of T steps and T + 1 observations, in HDF5."""

from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from drone_env.core.actions import N_ACTIONS
from drone_env.datasets.config import DatasetConfig
from drone_env.datasets.trajectories import Trajectory, Write
from drone_env.errors import MissingPackageError
from drone_env.installer import DISTRIBUTION

FOLDER = "minari"
OLDEST = "0.5.4"
"""Before, Minari kept every grid as a JPEG picture, which loses cells."""
NEEDED = f"minari[hdf5] {OLDEST} or newer, which asks for Python 3.11,"


def dataset_id(config: DatasetConfig) -> str:
    """The name under which Minari loads the data set."""
    return f"drone_delivery_{config.task.short_name}-v{config.task.version}"


@contextmanager
def minari_writer(folder: Path, config: DatasetConfig) -> Generator[Write, None, None]:
    """Writes a Minari data set into `minari/<dataset id>` of a folder.

    `minari.load_dataset` finds it where the environment variable `MINARI_DATASETS_PATH` names that `minari` folder.
    `infos` have T + 1 entries, one for each observation, as Minari's own collector writes them; where an entry is about
    an action, the last one, after which none was flown, is NaN, False or -1.

    Raises:
        MissingPackageError: if Minari from 0.5.4 on or h5py is not installed.
    """
    try:
        import h5py  # noqa: F401  # pyright: ignore[reportUnusedImport] - Minari asks for it only when it writes
        import minari
        from minari.data_collector import EpisodeBuffer
        from minari.dataset.minari_storage import MinariStorage
        from packaging.version import Version
    except ImportError as error:
        raise MissingPackageError(NEEDED, "data") from error
    if Version(minari.__version__) < Version(OLDEST):
        raise MissingPackageError(f"{NEEDED} (but {minari.__version__})", "data")
    # Declared to take lists, which it does not need: arrays are written faster.
    buffer: Any = EpisodeBuffer
    env = gymnasium.make(config.task.gym_id, reward_profile=config.reward_profile)
    # Minari reads a relative path as relative to itself when it adds up sizes.
    home = folder.resolve() / FOLDER / dataset_id(config)
    home.mkdir(parents=True)
    storage = MinariStorage.new(
        home / "data",
        observation_space=env.observation_space,
        action_space=env.action_space,
        env_spec=env.spec,
        data_format="hdf5",
        jpeg_encoding=False,
    )
    about = config.as_json()
    storage.update_metadata(
        {
            "dataset_id": dataset_id(config),
            "minari_version": minari.__version__,
            "algorithm_name": f"{', '.join(config.agents)} (epsilon {config.epsilon:g})",
            "description": "Flights with the exact V*, Q* and regret of every step, in infos.",
            "requirements": [f"{DISTRIBUTION}>={about['package_version']}"],
            "drone_env": about,
        }
    )

    def write(trajectories: Sequence[Trajectory]) -> None:
        storage.update_episodes(buffer(**_episode(trajectory)) for trajectory in trajectories)
        numbers = [trajectory.number for trajectory in trajectories]
        storage.update_episode_metadata([_about(trajectory) for trajectory in trajectories], numbers)

    yield write


def _episode(trajectory: Trajectory) -> dict[str, Any]:
    return {
        "id": trajectory.number,
        "seed": trajectory.seed,
        "observations": {"grid": trajectory.grids, "telemetry": trajectory.telemetry},
        "actions": trajectory.actions.astype(np.int64),
        "rewards": trajectory.rewards,
        "terminations": trajectory.terminated,
        "truncations": np.zeros(trajectory.steps, np.bool_),
        "infos": {
            "action_mask": trajectory.action_masks,
            "score": trajectory.scores,
            "event": trajectory.events,
            "value": trajectory.values,
            "q_values": np.concatenate([trajectory.q_values, np.full((1, N_ACTIONS), np.nan)]),
            "regret": np.append(trajectory.regrets, np.nan),
            "optimal_actions": np.concatenate([trajectory.optimal_actions, np.zeros((1, N_ACTIONS), np.bool_)]),
            "agent_action": np.append(trajectory.agent_actions, np.int8(-1)),
        },
    }


def _about(trajectory: Trajectory) -> dict[str, Any]:
    return {
        "agent": trajectory.agent,
        "final_score": float(trajectory.scores[-1]),
        "optimal_score": float(trajectory.values[0]),
    }
