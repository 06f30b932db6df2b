"""Data sets: every row beside the exact values, the same in every run, there whole or not at all."""

import json
import sys
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest

from drone_env.cli import main
from drone_env.core.episode import Episode
from drone_env.core.seeds import SPLITS, split_seeds
from drone_env.core.tasks import TASKS, get_task
from drone_env.datasets import build
from drone_env.datasets.build import build_dataset
from drone_env.datasets.trajectories import FORMAT, DatasetConfig, fly_map, random_actions
from drone_env.errors import InvalidValueError, MissingPackageError
from drone_env.files import locked
from drone_env.llm.answers import Answer, read_answer
from drone_env.llm.prompt import get_prompt
from drone_env.llm.text_episode import TextEpisode
from drone_env.planning.optimal import solve
from drone_env.planning.solver import ExactSolver
from drone_env.planning.stops import next_stops, stop_values
from drone_env.results.evaluate import episodes_key, run_episodes

MINARI = sys.version_info >= (3, 11)


def made(folder: Path, config: DatasetConfig) -> Path:
    build_dataset(config, folder / "set")
    return folder / "set"


def config_of(task: str, *maps: Any, **options: Any) -> DatasetConfig:
    return DatasetConfig(get_task(task), *maps, **options)


def rows(folder: Path) -> list[dict]:
    return pyarrow.parquet.read_table(folder / "steps.parquet").to_pylist()


def flights(folder: Path) -> list[list[dict]]:
    by_episode: dict[int, list[dict]] = {}
    for row in rows(folder):
        by_episode.setdefault(row["episode"], []).append(row)
    assert list(by_episode) == list(range(len(by_episode)))
    return list(by_episode.values())


@pytest.mark.parametrize("task", ["medium", "skyline_easy"])
def test_every_row_is_the_step_that_a_replay_flies_beside_the_exact_values(task: str, tmp_path: Path) -> None:
    folder = made(tmp_path, config_of(task, range(5, 6), "train", reward_profile="tiered"))
    for flight in flights(folder):
        first = flight[0]
        episode = Episode(task, "tiered", first["seed"])
        solver = ExactSolver(episode)
        for number, row in enumerate(flight):
            seen = episode.observation()
            assert row["task"] == episode.task.id
            assert (row["seed"], row["agent"], row["step"]) == (first["seed"], first["agent"], number)
            assert row["grid"] == seen["grid"].ravel().tolist()
            assert row["telemetry"] == seen["telemetry"].tolist()
            assert row["action_mask"] == episode.action_mask().tolist()
            values = solver.q_values(episode)
            assert row["q_values"] == values.tolist()
            assert row["value"] == solver.value(episode)
            assert row["regret"] == values.max() - values[row["action"]]
            assert np.flatnonzero(row["optimal_actions"]).tolist() == list(solver.optimal_actions(episode))
            assert (row["reward"], row["score"]) == (episode.step(row["action"]), episode.score)
            assert (row["terminated"], row["event"]) == (episode.ended, episode.event.name.lower())
        assert episode.ended
        assert {row["optimal_score"] for row in flight} == {solve(task, first["seed"]).score}


def test_random_actions_replace_the_agents_with_probability_epsilon() -> None:
    draws = list(islice(random_actions("random", 3), 10_000))
    # 5 standard errors are 0.022 and 0.02.
    assert np.mean([share < 0.25 for share, _ in draws]) == pytest.approx(0.25, abs=0.022)
    assert np.bincount([action for _, action in draws]) / len(draws) == pytest.approx(np.full(5, 0.2), abs=0.02)
    (flight,) = fly_map(config_of("easy", range(3, 4), agents=["random"], epsilon=0.25), 3)
    own = flight.steps["agent_action"].tolist()
    taken = [action if share < 0.25 else choice for choice, (share, action) in zip(own, draws, strict=False)]
    assert flight.steps["action"].tolist() == taken != own


def test_a_flight_does_not_depend_on_what_else_is_flown() -> None:
    draws = [list(islice(random_actions(*of), 100)) for of in (("optimal", 1), ("optimal", 2), ("greedy", 1))]
    assert draws[0] not in draws[1:]
    (flight,) = fly_map(config_of("medium", range(2, 3), agents=["greedy"], epsilon=0.5), 2)
    _, same, _ = fly_map(config_of("medium", range(4), epsilon=0.5), 2)
    assert all(np.array_equal(flight.steps[name], same.steps[name]) for name in ("action", "grid"))


def test_the_same_arguments_give_the_same_bytes(tmp_path: Path) -> None:
    config = config_of("easy", range(4), prompt="plan", minari=MINARI)
    contents = []
    for name in ("first", "second"):
        build_dataset(config, tmp_path / name)
        contents.append({p.relative_to(tmp_path / name): p.read_bytes() for p in (tmp_path / name).rglob("*.*")})
    first, second = contents
    assert first.keys() == second.keys()
    assert [str(path) for path in first if first[path] != second[path]] == []


def test_types_shapes_and_metadata_of_the_file(tmp_path: Path) -> None:
    config = config_of("hard", range(3), "train", ["greedy"])
    folder = made(tmp_path, config)
    schema = pyarrow.parquet.read_schema(folder / "steps.parquet")
    expected = {"seed": "int64", "grid": "uint8[324]", "reward": "double", "event": "string", "q_values": "double[5]"}
    for name, kind in expected.items():
        found = schema.field(name).type
        text = f"{found.value_type}[{found.list_size}]" if pyarrow.types.is_fixed_size_list(found) else str(found)
        assert text == kind, name
    assert json.loads(schema.field("grid").metadata[b"shape"]) == [18, 18]
    assert all(field.metadata[b"description"] and not field.nullable for field in schema)
    about = json.loads(schema.metadata[b"drone_env"])
    assert about == config.as_json()
    assert (about["format"], about["format_version"], "prompt" in about) == (FORMAT, 1, False)


@pytest.mark.skipif(not MINARI, reason="Minari asks for Python 3.11")
def test_minari_loads_the_same_flights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import minari

    monkeypatch.setattr(build, "ROWS_PER_GROUP", 60)
    folder = made(tmp_path, config_of("skyline_easy", range(3), reward_profile="composite", minari=True))
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder / "minari"))
    dataset = minari.load_dataset("drone_delivery_skyline_easy-v2")
    of_rows = flights(folder)
    assert (dataset.total_episodes, dataset.total_steps) == (len(of_rows), sum(map(len, of_rows)))
    env = dataset.recover_environment()
    assert (env.observation_space, env.action_space) == (dataset.observation_space, dataset.action_space)
    abouts = dataset.storage.get_episode_metadata(range(len(of_rows)))
    for flight, episode, about in zip(of_rows, dataset.iterate_episodes(), abouts, strict=True):
        infos = episode.infos
        for column, values in {
            "action": episode.actions, "reward": episode.rewards, "terminated": episode.terminations,
            "value": infos["value"][:-1], "q_values": infos["q_values"][:-1], "score": infos["score"][1:],
        }.items():  # fmt: skip
            assert values.tolist() == [row[column] for row in flight], column
        assert infos["value"][-1] == infos["score"][-1] == about["final_score"]
        assert (about["agent"], about["optimal_score"]) == (flight[0]["agent"], flight[0]["optimal_score"])
        seen, told = zip(
            env.reset(seed=about["seed"]), *(env.step(action)[::4] for action in episode.actions), strict=True
        )
        for name, values in episode.observations.items():
            assert np.array_equal(values, [observation[name] for observation in seen]), name
        for name in ("action_mask", "score"):
            assert np.array_equal(infos[name], [info[name] for info in told]), name
        assert not episode.truncations.any()


@pytest.mark.skipif(not MINARI, reason="Minari asks for Python 3.11")
@pytest.mark.parametrize("own", [False, True])
def test_minari_normalises_scores_between_random_and_the_optimum(
    own: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import minari

    task, maps = get_task("easy"), split_seeds("test", 1000)
    if own:  # the package has no results of it
        task, maps = replace(task, deliveries=2), range(3, 7)
        monkeypatch.setitem(TASKS, task.id, task)
    folder = made(tmp_path, DatasetConfig(task, range(3, 7), agents=["greedy"], minari=True))
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder / "minari"))
    dataset = minari.load_dataset("drone_delivery_easy-v1")
    flown = run_episodes(episodes_key(task, "random", maps))
    means = np.array([flown.scores.mean(), flown.optimal_scores.mean()])
    assert minari.get_normalized_score(dataset, means) == pytest.approx([0, 1])


def test_a_missing_minari_is_named_and_nothing_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "minari", None)
    error, text = (MissingPackageError, "minari is not installed") if MINARI else (InvalidValueError, "Python 3.11")
    with pytest.raises(error, match=text):
        made(tmp_path, config_of("easy", range(1), minari=True))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("task", "name"), [("medium", "plan"), ("skyline_easy", "compass"), ("easy", "think")])
def test_a_conversation_is_the_request_of_a_prompt_and_an_answer_with_its_exact_values(
    task: str, name: str, tmp_path: Path
) -> None:
    prompt, agents = get_prompt(name), ["optimal", "greedy"]
    config = config_of(task, range(3, 5), "train", agents, epsilon=0.3, prompt=name)
    folder = made(tmp_path, config)
    chat = [json.loads(line) for line in (folder / "chat.jsonl").read_text(encoding="utf-8").splitlines()]
    for steps in flights(folder):
        episode = Episode(task, seed=steps[0]["seed"])
        solver = ExactSolver(episode)
        while not episode.ended:
            row, step = chat.pop(0), steps[episode.steps]
            assert (row["seed"], row["agent"], row["step"]) == (step["seed"], step["agent"], step["step"])
            *request, answer = row["messages"]
            assert request == prompt.messages(episode)
            reading = read_answer(Answer(text=answer["content"]), prompt.plan, prompt.marks)
            assert [action.name for action in reading.actions] == row["actions"]
            flown = [step["action"] for step in steps] if prompt.plan else [step["agent_action"]]
            assert list(reading.actions) == flown
            for best, regrets in zip(row["optimal_actions"], row["regrets"], strict=True):
                assert best == [action.name for action in solver.optimal_actions(episode)]
                values = solver.q_values(episode)
                assert regrets == (values.max() - values).tolist()
                episode.step(steps[episode.steps]["action"])
        assert (row["score"], row["regret"]) == (episode.score, solve(task, episode.seed).score - episode.score)
    assert chat == []
    about = json.loads(pyarrow.parquet.read_schema(folder / "steps.parquet").metadata[b"drone_env"])
    assert (about["task_digest"], about["prompt_digest"]) == (config.task.digest, prompt.digest)


def test_a_conversation_by_stops_is_that_of_a_run_with_the_best_stops(tmp_path: Path) -> None:
    config = config_of("skyline_easy", range(3, 6), "train", ["optimal"], epsilon=0.4, prompt="stops")
    folder = made(tmp_path, config)
    chat = [json.loads(line) for line in (folder / "chat.jsonl").read_text(encoding="utf-8").splitlines()]
    wrong = 0
    for steps in flights(folder):
        run = TextEpisode("skyline_easy", steps[0]["seed"], "stops")
        while run.messages:
            row, values = chat.pop(0), stop_values(run.episode)
            *request, answer = row["messages"]
            assert (request, row["step"], row["options"]) == (run.messages, run.episode.steps, list(values))
            best = max(values.values())
            assert row["optimal_actions"] == [[label for label, value in values.items() if value == best]]
            assert row["actions"] == [answer["content"]] == row["optimal_actions"][0][:1]
            assert row["regrets"] == [[best - value for value in values.values()]]
            ahead = [step["action"] for step in steps[run.episode.steps :]]
            flown = [one.label for one in next_stops(run.episode) if ahead[: len(one.actions)] == one.actions]
            wrong += answer["content"] not in flown
            run.answer(flown[-1])
        assert row["score"] == run.score
    assert chat == []
    assert wrong > 0
    with pytest.raises(InvalidValueError, match="agents must be optimal alone"):
        config_of("skyline_easy", range(3), "train", prompt="stops")


# A full charge can cost a parcel where steps are short.
@pytest.mark.parametrize(("task", "most"), [("skyline_easy", 0.01), ("rush_easy", 0.1), ("medium", 0)])
def test_the_best_stops_reach_the_score_that_they_promise(task: str, most: float) -> None:
    for seed in range(3):
        episode = Episode(task, seed=seed)
        promised = stop_values(episode)
        best = max(promised.values())
        while values := stop_values(episode):
            assert max(values.values()) == best
            label = max(values, key=values.__getitem__)
            episode.fly(next(stop.actions for stop in next_stops(episode) if stop.label == label))
        assert episode.counted_score() == best
        assert 0 <= solve(task, seed).score - best <= most


def test_an_interrupted_run_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    maps = []
    monkeypatch.setattr(build, "ROWS_PER_GROUP", 1)

    def interrupt() -> None:
        maps.append((tmp_path / "set").exists())
        if len(maps) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_dataset(config_of("easy", range(5), prompt="plan"), tmp_path / "set", on_map=interrupt)
    assert maps == [False, False, False]
    assert list(tmp_path.iterdir()) == []


def test_the_next_run_removes_what_a_killed_one_left(tmp_path: Path) -> None:
    part = tmp_path / "set.part"
    (part / "dataset" / "old").mkdir(parents=True)
    with locked(part / "lock", "mine"), pytest.raises(InvalidValueError, match="another process is writing"):
        made(tmp_path, config_of("easy", range(1)))
    folder = made(tmp_path, config_of("easy", range(1)))
    assert list(tmp_path.iterdir()) == [folder]
    assert not (folder / "old").exists()


def test_an_empty_folder_is_filled_and_a_full_one_left_alone(tmp_path: Path) -> None:
    config = config_of("easy", range(1))
    (tmp_path / "set").mkdir()
    assert build_dataset(config, tmp_path / "set") == len(rows(tmp_path / "set"))
    (tmp_path / "file").touch()
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    for taken in ("set", "file"):
        with pytest.raises(InvalidValueError, match="not an empty folder"):
            build_dataset(config, tmp_path / taken)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "set")
    chosen = ["--agents", "greedy", "--epsilon", "0", "--offset", "4", "--split", "test"]
    assert main(["dataset", "--task", "easy", "--maps", "3", "--out", out, *chosen]) == 0
    flown = rows(tmp_path / "set")
    assert sorted({row["seed"] for row in flown}) == [SPLITS["test"].start + n for n in (4, 5, 6)]
    assert capsys.readouterr().out == f"{out}: {len(flown):,} steps of 3 flights over 3 maps\n"
