"""Models of Stable-Baselines3 as agents: from memory, and from the files that they are saved in."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sb3_contrib import MaskablePPO
from stable_baselines3 import DQN, PPO

from drone_env import evaluate, make_agent
from drone_env.cli import main
from drone_env.core.episode import Episode, choices
from drone_env.core.tasks import get_task
from drone_env.envs.sb3 import FORMS, DroneDeliveryVecEnv
from drone_env.errors import CheckpointError
from drone_env.results.evaluate import episodes_key, run_episodes

MAPS = range(100, 116)
NETWORK: Any = {"policy_kwargs": {"net_arch": [8]}, "seed": 3, "device": "cpu"}


def model_of(kind: Any, form: str, task: str = "easy") -> Any:
    """A model that has learned nothing, and so flies in its own way."""
    policy = {"dict": "MultiInputPolicy", "flat": "MlpPolicy"}[form]
    return kind(policy, DroneDeliveryVecEnv(task, 2, observation=form), **NETWORK)


def scores_in_its_own_world(model: Any, form: str, task: str) -> list[float]:
    """The scores of the likeliest actions, flown in the environment that the model was made for."""
    env = DroneDeliveryVecEnv(task, len(MAPS), observation=form)
    env.seed(MAPS.start)
    seen, scores = env.reset(), dict[int, float]()
    while len(scores) < len(MAPS):
        seen, _, dones, infos = env.step(model.predict(seen, deterministic=True)[0])
        for i in np.flatnonzero(dones).tolist():
            scores.setdefault(i, infos[i]["score"])
    return [scores[i] for i in range(len(MAPS))]


@pytest.mark.parametrize("task", ["easy", "skyline_easy"])
@pytest.mark.parametrize(("kind", "form"), [(PPO, "flat"), (PPO, "dict"), (DQN, "flat")])
def test_a_model_flies_as_it_does_in_the_environment_it_was_made_for(
    kind: Any, form: str, task: str, tmp_path: Path
) -> None:
    model, wrapper = model_of(kind, form, task), FORMS[form].__name__
    expected = scores_in_its_own_world(model, form, task)
    assert evaluate(model, task, seeds=MAPS, wrapper=wrapper).scores.tolist() == expected
    model.save(tmp_path / "model.zip")
    key = episodes_key(task, f"{tmp_path / 'model.zip'}:{wrapper}", MAPS)
    assert run_episodes(key).scores.tolist() == expected


def test_a_policy_is_known_by_its_weights(tmp_path: Path) -> None:
    names = []
    for number, steps in enumerate((0, 0, 4)):
        model = model_of(PPO, "flat")
        model.n_steps = model.rollout_buffer.buffer_size = 2
        if steps:
            model.learn(steps)
        model.save(tmp_path / f"{number}.zip")
        names.append(f"{tmp_path / f'{number}.zip'}:FlatObservation")
    first, same, learned = (episodes_key("easy", name, range(1)).config_hash for name in names)
    assert first == same != learned


def test_a_masked_policy_is_told_what_would_bump(tmp_path: Path) -> None:
    task = get_task("skyline_easy")
    model_of(MaskablePPO, "dict", task.id).save(tmp_path / "model.zip")
    agent = make_agent(f"{tmp_path / 'model.zip'}:OneHotPlanes", task)
    for seed in MAPS:
        agent.reset(seed)
        episode = Episode(task, seed=seed)
        for action in choices(episode, agent.act):
            assert episode.action_mask()[int(action)]
            episode.step(action)


def test_a_wrapper_of_ones_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_wrapper.py").write_text(
        "from drone_env.envs.wrappers import FlatObservation\nclass Mine(FlatObservation):\n    pass\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    model_of(PPO, "flat").save(tmp_path / "model.zip")
    scores = [
        run_episodes(episodes_key("easy", f"{tmp_path / 'model.zip'}:{wrapper}", MAPS)).scores.tolist()
        for wrapper in ("FlatObservation", "my_wrapper:Mine")
    ]
    assert scores[0] == scores[1]


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "model.zip"
    model_of(PPO, "flat").save(file)
    with pytest.raises(CheckpointError, match=r"takes Box.*; 'easy_delivery' with wrapper none has"):
        make_agent(f"{file}", "easy")
    file.write_bytes(b"no archive")
    with pytest.raises(CheckpointError, match="contains no policy of Stable-Baselines3"):
        make_agent(f"{file}:FlatObservation", "easy")


def test_the_command_says_that_it_trusts_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "model.zip"
    model_of(PPO, "flat").save(file)
    told = f"{file}: reading it runs code that it contains; name only files that you trust\n"
    maps = ["--task", "easy", "--seeds", "3:5"]
    for command in (
        ["fly", "--agent"],
        ["analyse-flight", "--task", "easy", "--agent"],
        ["evaluate", *maps, "--agents", "greedy"],
        ["compare", *maps, "greedy"],
    ):
        assert main([*command, f"{file}:FlatObservation"]) == 0
        assert capsys.readouterr().err.startswith(told)
