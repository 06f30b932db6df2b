"""An episode as an object: its start, its snapshots, and what it refuses."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drone_env.core.batch import Batch
from drone_env.core.episode import Episode
from drone_env.core.seeds import next_seed
from drone_env.core.tasks import get_task
from drone_env.errors import DroneEnvError, EpisodeError, InvalidValueError
from tests.same import assert_same
from tests.toy import fly, toy_episode


class TestReset:
    def test_without_a_seed_the_first_map_is_drawn_from_the_train_split_and_the_others_follow(self) -> None:
        episodes = [Episode() for _ in range(20)]
        seeds = [episode.reset() for episode in episodes]
        assert len(set(seeds)) == 20
        assert all(0 <= seed < 2**52 for seed in seeds)
        assert [episode.reset() for episode in episodes] == [next_seed(seed) for seed in seeds]

    def test_the_reward_profile_is_chosen_per_episode_and_kept_until_another_is(self) -> None:
        episode = Episode("easy", "tiered")
        episode.reset(1, "score")
        assert (episode.reward_profile.id, episode.get_state().reward_profile.id) == ("score", "score")
        assert fly(episode, "W") == [0.0]
        episode.reset(2)
        assert episode.reward_profile.id == "score"
        assert fly(episode, "W") == [0.0]

    @pytest.mark.parametrize(
        "arguments", [(2, "no_such"), (-1, "score"), (2**53, None), (True, None), (7.0, None), ("7", None)]
    )
    def test_a_refused_reset_keeps_the_episode_and_its_profile(self, arguments: tuple[Any, Any]) -> None:
        episode = Episode("easy", "tiered", 1)
        before = episode.get_state()
        with pytest.raises(DroneEnvError):
            episode.reset(*arguments)
        assert episode.get_state() == before


class TestState:
    @pytest.mark.parametrize(("task", "profile"), [("medium", "tiered"), ("easy", "composite")])
    def test_a_snapshot_of_another_task_or_profile_is_refused(self, task: str, profile: str) -> None:
        other = Episode(task, profile, 1)
        episode = Episode("easy", "tiered", 2)
        before = episode.get_state()
        with pytest.raises(InvalidValueError, match=f"{task}_delivery.*{profile}.*easy_delivery.*tiered"):
            episode.set_state(other.get_state())
        assert episode.get_state() == before

    def test_a_batch_refuses_the_snapshot_of_another_task_and_of_other_rules_by_their_names(self) -> None:
        easy = get_task("easy")
        batches = [Batch(task, 2) for task in (easy, replace(easy, max_steps=9), replace(easy, id="mine"))]
        for batch in batches:
            batch.reset(np.arange(2))
        before = batches[0].get_state()
        for other in batches[1:]:
            name = f"{other.task.id} .rules {other.task.digest}., not of easy_delivery .rules {easy.digest}"
            with pytest.raises(InvalidValueError, match=name):
                batches[0].set_state(other.get_state())
        assert_same(batches[0].get_state(), before)

    def test_observation_is_a_copy(self) -> None:
        episode = toy_episode(["@0", ".."])
        episode.observation()["grid"][:] = 0
        assert episode.grid().tolist() == [[6, 4], [0, 0]]

    def test_before_the_first_reset_there_is_nothing_to_fly(self) -> None:
        episode = Episode()
        for call in (lambda: episode.step(0), lambda: episode.seed, episode.get_state):
            with pytest.raises(EpisodeError, match="reset"):
                call()
        assert "reset" in episode.message


class TestRefusedInput:
    @pytest.mark.parametrize("action", [5, -1, 1.5, "UP", None, True])
    def test_invalid_action_leaves_the_state_as_it_was(self, action: Any) -> None:
        episode = toy_episode(["@.0", "..."])
        before = episode.get_state()
        with pytest.raises(InvalidValueError, match="0 UP, 1 DOWN, 2 LEFT, 3 RIGHT, 4 WAIT"):
            episode.step(action)
        assert episode.get_state() == before
