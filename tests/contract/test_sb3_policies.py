"""Models of Stable-Baselines3 as agents."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sb3_contrib import MaskablePPO
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from drone_env import evaluate
from drone_env.agents.custom import as_agent
from drone_env.core.episode import Episode, choices
from drone_env.core.tasks import get_task
from drone_env.envs.drone_delivery import DroneDeliveryEnv
from drone_env.envs.sb3 import DroneDeliveryVecEnv
from drone_env.errors import InvalidValueError, UnsupportedTaskError
from drone_env.results.evaluate import episodes_key

MAPS = range(100, 116)
NETWORK: Any = {"policy_kwargs": {"net_arch": [8]}, "seed": 3, "device": "cpu"}


def model_of(kind: Any, form: str, task: str = "easy") -> Any:
    """A model that has learned nothing, and so flies in its own way."""
    if form == "plain":
        return kind("MultiInputPolicy", DummyVecEnv([lambda: DroneDeliveryEnv(task)]), **NETWORK)
    policy = "MlpPolicy" if form == "flat" else "MultiInputPolicy"
    return kind(policy, DroneDeliveryVecEnv(task, 2, observation=form), **NETWORK)


def scores_in_its_own_world(model: Any, form: str, task: str) -> list[float]:
    """The scores of the likeliest actions, flown in the environment that the model was made for."""
    single: Any = [lambda: DroneDeliveryEnv(task)] * len(MAPS)
    env: Any = DummyVecEnv(single) if form == "plain" else DroneDeliveryVecEnv(task, len(MAPS), observation=form)
    env.seed(MAPS.start)
    seen, scores = env.reset(), dict[int, float]()
    while len(scores) < len(MAPS):
        seen, _, dones, infos = env.step(model.predict(seen, deterministic=True)[0])
        for i in np.flatnonzero(dones).tolist():
            scores.setdefault(i, infos[i]["score"])
    return [scores[i] for i in range(len(MAPS))]


@pytest.mark.parametrize(
    ("kind", "form", "task"),
    [(PPO, "flat", "easy"), (PPO, "dict", "skyline_easy"), (DQN, "stops", "skyline_easy"), (PPO, "plain", "easy")],
)
def test_a_model_flies_as_it_does_in_the_environment_it_was_made_for(kind: Any, form: str, task: str) -> None:
    model = model_of(kind, form, task)
    assert evaluate(model, task, seeds=MAPS).scores.tolist() == scores_in_its_own_world(model, form, task)


def test_a_model_is_known_by_its_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "saved_models.py").write_text(
        "from stable_baselines3 import PPO\n"
        "first, same, learned = (PPO.load(f'{n}.zip', device='cpu') for n in range(3))"
    )
    monkeypatch.chdir(tmp_path)
    for number, steps in enumerate((0, 0, 4)):
        model = model_of(PPO, "flat")
        model.n_steps = model.rollout_buffer.buffer_size = 2
        if steps:
            model.learn(steps)
        model.save(f"{number}.zip")
    names = ("first", "same", "learned")
    first, same, learned = (episodes_key("easy", f"saved_models:{name}", range(1)).config_hash for name in names)
    assert first == same != learned


def test_a_masked_model_is_told_what_would_bump() -> None:
    task = get_task("skyline_easy")
    agent = as_agent(model_of(MaskablePPO, "dict", task.id), task)
    for seed in MAPS:
        agent.reset(seed)
        episode = Episode(task, seed=seed)
        for action in choices(episode, agent.act):
            assert episode.action_mask()[int(action)]
            episode.step(action)


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(
        UnsupportedTaskError, match=r"another task .* takes Box.*; on 'medium_delivery' it can be Dict.* or Box"
    ):
        evaluate(model_of(PPO, "flat"), "medium")
    env = VecNormalize(DroneDeliveryVecEnv("easy", 2, observation="flat"))
    with pytest.raises(InvalidValueError, match="need a class of your own"):
        evaluate(PPO("MlpPolicy", env, **NETWORK), "easy")
