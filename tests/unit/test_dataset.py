"""Data sets: every row beside the exact values, the same in every run, there whole or not at all."""

import json
import re
import sys
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest

from drone_env.cli import main
from drone_env.core.actions import N_ACTIONS, Event
from drone_env.core.episode import Episode
from drone_env.core.seeds import SPLITS, split_seeds
from drone_env.core.tasks import get_task
from drone_env.datasets import build
from drone_env.datasets.build import build_dataset
from drone_env.datasets.config import FORMAT, DatasetConfig, dataset_config
from drone_env.datasets.trajectories import chance, fly_map
from drone_env.errors import InvalidValueError, MissingPackageError, TooLargeError, UnknownNameError
from drone_env.installer import install_command
from drone_env.planning import states
from drone_env.planning.optimal import solve
from drone_env.planning.solver import ExactSolver
from tests.which_tasks import SMALL

FORMATS = ("parquet", "minari") if sys.version_info >= (3, 11) else ("parquet",)
needs_minari = pytest.mark.skipif("minari" not in FORMATS, reason="Minari asks for Python 3.11")

SHORT = [task.short_name for task in SMALL.values() if task.short_name not in ("skyline_hard", "city_small")]


def made(folder: Path, config: DatasetConfig, formats: tuple[str, ...] = ("parquet",), **options: int) -> Path:
    build_dataset(config, folder / "set", formats, **options)
    return folder / "set"


def rows(folder: Path) -> list[dict]:
    return pyarrow.parquet.read_table(folder / "steps.parquet").to_pylist()


def flights(folder: Path) -> list[list[dict]]:
    by_episode: dict[int, list[dict]] = {}
    for row in rows(folder):
        by_episode.setdefault(row["episode"], []).append(row)
    assert list(by_episode) == list(range(len(by_episode)))
    return list(by_episode.values())


@pytest.mark.parametrize("task", SHORT)
def test_every_row_is_the_step_that_a_replay_flies_beside_the_exact_values(task: str, tmp_path: Path) -> None:
    folder = made(tmp_path, dataset_config(task, range(5, 6), "train", reward_profile="tiered"))
    for flight in flights(folder):
        first = flight[0]
        episode = Episode(task, "tiered")
        episode.reset(first["seed"])
        solver = ExactSolver(episode)
        rewards = []
        for number, row in enumerate(flight):
            seen = episode.observation()
            assert (row["task"], row["task_version"]) == (episode.task.id, episode.task.version)
            assert (row["seed"], row["agent"], row["step"]) == (first["seed"], first["agent"], number)
            assert row["grid"] == seen["grid"].ravel().tolist()
            assert row["telemetry"] == seen["telemetry"].tolist()
            assert row["action_mask"] == episode.action_mask().tolist()
            assert row["q_values"] == solver.q_values(episode).tolist()
            assert row["value"] == solver.value(episode)
            assert row["regret"] == solver.regret(episode, row["action"])
            assert np.flatnonzero(row["optimal_actions"]).tolist() == list(solver.optimal_actions(episode))
            rewards.append(episode.step(row["action"]))
            assert (row["reward"], row["score"]) == (rewards[-1], episode.score)
            assert (row["terminated"], row["event"]) == (episode.ended, episode.event.name.lower())
        assert episode.ended
        assert {row["final_score"] for row in flight} == {episode.score}
        assert {row["optimal_score"] for row in flight} == {solve(task, first["seed"]).score}
        left = [row["return_to_go"] for row in flight]
        assert left == pytest.approx([sum(rewards[i:]) for i in range(len(rewards))])


@pytest.mark.parametrize("task", SHORT)
def test_the_losses_of_a_flight_add_up_to_what_it_missed(task: str) -> None:
    for flight in fly_map(dataset_config(task, range(20, 21), epsilon=0.3), 20):
        flown = flight.q_values[np.arange(flight.steps), flight.actions]
        assert flown.tobytes() == flight.values[1:].tobytes()
        losses = [Fraction(v) - Fraction(q) for v, q in zip(flight.values.tolist(), flown.tolist(), strict=False)]
        assert sum(losses) == Fraction(flight.values[0]) - Fraction(flight.scores[-1])
        assert flight.regrets.tolist() == [float(loss) for loss in losses]
        assert min(losses) >= 0
    (optimal,) = fly_map(dataset_config(task, range(5), agents=["optimal"], epsilon=0), 4)
    assert not optimal.regrets.any()
    assert optimal.actions.tolist() == optimal.agent_actions.tolist()


def test_chance_flies_with_probability_epsilon() -> None:
    def strays(epsilon: float, maps: int) -> float:
        config = dataset_config("easy", range(maps), agents=["random"], epsilon=epsilon)
        changed = [f.actions != f.agent_actions for seed in config.seeds for f in fly_map(config, seed)]
        return float(np.concatenate(changed).mean())

    assert strays(0, maps=3) == 0
    # One random action in five is the agent's own; 0.04 is 5 standard errors over the 2,500 steps of 50 maps.
    assert strays(0.25, maps=50) == pytest.approx(0.2, abs=0.04)
    assert strays(1, maps=13) == pytest.approx(0.8, abs=0.08)


def test_chance_is_uniform_and_its_own_for_each_agent_and_map() -> None:
    def draws(agent: str, seed: int) -> list[tuple[float, int]]:
        return list(islice(chance(agent, seed), 5000))

    shares, actions = zip(*draws("optimal", 1), strict=True)
    assert 0 <= min(shares) < max(shares) < 1
    assert np.mean(shares) == pytest.approx(0.5, abs=0.02)
    assert np.bincount(actions, minlength=N_ACTIONS) == pytest.approx(1000, abs=150)
    assert draws("optimal", 1) == draws("optimal", 1) != draws("optimal", 2)
    assert draws("optimal", 1) != draws("greedy", 1)
    # So a flight does not depend on what else is flown.
    (flight,) = fly_map(dataset_config("medium", range(2, 3), agents=["greedy"], epsilon=0.5), 2)
    _, same, _ = fly_map(dataset_config("medium", range(4), epsilon=0.5), 2)
    assert (flight.actions.tobytes(), flight.grids.tobytes()) == (same.actions.tobytes(), same.grids.tobytes())


def test_the_same_arguments_give_the_same_bytes(tmp_path: Path) -> None:
    config = dataset_config("easy", range(4))
    contents = []
    for name in ("first", "second"):
        build_dataset(config, tmp_path / name, FORMATS)
        contents.append({p.relative_to(tmp_path / name): p.read_bytes() for p in (tmp_path / name).rglob("*.*")})
    first, second = contents
    assert first.keys() == second.keys()
    assert [str(path) for path in first if first[path] != second[path]] == []


def test_types_shapes_and_metadata_of_the_file(tmp_path: Path) -> None:
    config = dataset_config("hard", range(3), "train", ["greedy"])
    file = pyarrow.parquet.ParquetFile(made(tmp_path, config, rows_per_group=50) / "steps.parquet")
    schema = file.schema_arrow
    expected = {
        "seed": "int64", "step": "int32", "grid": "uint8[324]", "telemetry": "float[5]", "action_mask": "int8[5]",
        "action": "int8", "reward": "double", "terminated": "bool", "event": "string", "q_values": "double[5]",
        "regret": "double", "optimal_actions": "bool[5]", "value": "double",
    }  # fmt: skip
    for name, kind in expected.items():
        found = schema.field(name).type
        text = f"{found.value_type}[{found.list_size}]" if pyarrow.types.is_fixed_size_list(found) else str(found)
        assert text == kind, name
    assert json.loads(schema.field("grid").metadata[b"shape"]) == [18, 18]
    assert all(field.metadata[b"description"] and not field.nullable for field in schema)
    about = json.loads(schema.metadata[b"drone_env"])
    assert about == config.as_json()
    assert (about["format"], about["format_version"]) == (FORMAT, 1)
    assert (about["task"]["max_steps"], about["epsilon"], about["seeds"], about["split"]) == (160, 0.1, [0, 3], "train")
    assert about["reward_profile"]["shaping_gamma"] == "0.99"
    assert file.metadata.num_row_groups > 1
    (tmp_path / "whole").mkdir()
    assert rows(made(tmp_path / "whole", config)) == rows(tmp_path / "set")
    assert {file.metadata.row_group(0).column(i).compression for i in range(len(expected))} == {"ZSTD"}


def test_the_hash_changes_with_everything_that_decides_the_rows() -> None:
    base = {"task": "easy", "seeds": range(3), "agents": ("greedy",), "epsilon": 0.1, "reward_profile": "aligned"}
    changes = [{}, {"task": "hard"}, {"seeds": range(4)}, {"agents": ("greedy", "random")}, {"epsilon": 0.2}]
    changes += [{"reward_profile": "score"}]
    hashes = [dataset_config(**{**base, **change}).as_json()["config_hash"] for change in changes]
    assert len(set(hashes)) == len(changes)
    assert hashes[0] == dataset_config(**base).as_json()["config_hash"]


@needs_minari
@pytest.mark.parametrize("task", ["easy", "skyline_easy"])
def test_minari_loads_the_same_flights(task: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import minari

    config = dataset_config(task, range(3), reward_profile="composite")
    folder = made(tmp_path, config, ("parquet", "minari"), rows_per_group=60)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder / "minari"))
    (name,) = minari.list_local_datasets()
    dataset = minari.load_dataset(name)
    of_rows = flights(folder)
    assert (dataset.total_episodes, dataset.total_steps) == (len(of_rows), sum(map(len, of_rows)))
    env = dataset.recover_environment()
    assert dataset.env_spec.id == get_task(task).gym_id
    assert (env.observation_space, env.action_space) == (dataset.observation_space, dataset.action_space)
    abouts = dataset.storage.get_episode_metadata(range(len(of_rows)))
    for flight, episode, about in zip(of_rows, dataset.iterate_episodes(), abouts, strict=True):
        steps, infos = len(flight), episode.infos
        for column, values in {
            "action": episode.actions, "reward": episode.rewards, "terminated": episode.terminations,
            "value": infos["value"][:-1], "q_values": infos["q_values"][:-1], "regret": infos["regret"][:-1],
            "optimal_actions": infos["optimal_actions"][:-1], "agent_action": infos["agent_action"][:-1],
            "action_mask": infos["action_mask"][:-1], "score": infos["score"][1:],
            "grid": episode.observations["grid"][:-1].reshape(steps, -1),
            "telemetry": episode.observations["telemetry"][:-1],
        }.items():  # fmt: skip
            assert values.tolist() == [row[column] for row in flight], column
        assert [Event(event).name.lower() for event in infos["event"][1:]] == [row["event"] for row in flight]
        assert not episode.truncations.any()
        assert infos["value"][-1] == infos["score"][-1] == flight[0]["final_score"] == about["final_score"]
        assert (about["agent"], about["optimal_score"]) == (flight[0]["agent"], flight[0]["optimal_score"])
        assert np.isnan(infos["q_values"][-1]).all()
        observation, _ = env.reset(seed=about["seed"])
        for number, action in enumerate(episode.actions):
            assert observation["grid"].tolist() == episode.observations["grid"][number].tolist()
            observation, reward, ended, _, _ = env.step(action)
            assert (reward, ended) == (episode.rewards[number], episode.terminations[number])
        assert observation["telemetry"].tolist() == episode.observations["telemetry"][-1].tolist()


def test_the_page_beside_it_explains_every_column(tmp_path: Path) -> None:
    folder = made(tmp_path, dataset_config("skyline_easy", range(1)), FORMATS)
    page = (folder / "README.md").read_text(encoding="utf-8")
    schema = pyarrow.parquet.read_schema(folder / "steps.parquet")
    assert all(f"| `{name}` |" in page for name in schema.names)
    assert "license: mit" in page
    assert ("MINARI_DATASETS_PATH" in page) == ("minari" in FORMATS)
    assert json.loads(page.split("```json")[1].split("```")[0])["config_hash"] in page


def test_an_interrupted_run_leaves_nothing(tmp_path: Path) -> None:
    maps = []

    def interrupt() -> None:
        maps.append((tmp_path / "set").exists())
        if len(maps) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_dataset(dataset_config("easy", range(5)), tmp_path / "set", FORMATS, rows_per_group=1, on_map=interrupt)
    assert maps == [False, False, False]
    assert list(tmp_path.iterdir()) == []


def test_an_empty_folder_is_filled_and_a_full_one_left_alone(tmp_path: Path) -> None:
    config = dataset_config("easy", range(1))
    (tmp_path / "set").mkdir()
    assert build_dataset(config, tmp_path / "set", FORMATS) == len(rows(tmp_path / "set"))
    before = (tmp_path / "set" / "steps.parquet").read_bytes()
    with pytest.raises(InvalidValueError, match="not an empty folder"):
        build_dataset(dataset_config("easy", range(2)), tmp_path / "set")
    (tmp_path / "file").touch()
    with pytest.raises(InvalidValueError, match="not an empty folder"):
        build_dataset(config, tmp_path / "file")
    with pytest.raises(InvalidValueError, match="in one that exists"):
        build_dataset(config, tmp_path / "missing" / "set")
    assert (tmp_path / "set" / "steps.parquet").read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "set"]


def test_a_map_too_large_to_be_solved_is_said_and_nothing_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(states, "MAX_BYTES", 100)
    with pytest.raises(TooLargeError, match="easy_delivery"):
        build_dataset(dataset_config("easy", range(2)), tmp_path / "set", FORMATS)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("package", "format_"), [("pyarrow", "parquet"), ("minari", "minari"), ("h5py", "minari")])
def test_a_missing_package_is_said_before_anything_is_flown(
    package: str, format_: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.setattr(build, "fly_map", None)
    with pytest.raises(MissingPackageError, match=re.escape(install_command("data"))):
        build_dataset(dataset_config("easy", range(2)), tmp_path / "set", (format_,))
    assert list(tmp_path.iterdir()) == []


@needs_minari
def test_a_minari_that_would_lose_cells_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("minari.__version__", "0.5.3")
    with pytest.raises(MissingPackageError, match=r"0\.5\.4 or newer.*0\.5\.3"):
        build_dataset(dataset_config("easy", range(2)), tmp_path / "set", ("minari",))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"epsilon": float("nan")}, "epsilon must be a probability"),
        ({"agents": []}, "agents must be one name or more"),
        ({"agents": ["greedy", "greedy"]}, "each once"),
        ({"agents": ["ace"]}, "greedy, optimal, pathqnet, random"),
        ({"seeds": split_seeds("test", 1), "split": "train"}, "not of the split"),
    ],
)
def test_a_configuration_that_is_not_allowed(changes: dict[str, Any], message: str) -> None:
    with pytest.raises((InvalidValueError, UnknownNameError), match=message):
        dataset_config(**{"task": "easy", "seeds": range(1), **changes})


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "set")
    chosen = ["--agents", "greedy", "--epsilon", "0", "--offset", "4", "--formats", "parquet", "--split", "test"]
    assert main(["dataset", "--task", "easy", "--maps", "3", "--out", out, *chosen]) == 0
    flown = rows(tmp_path / "set")
    assert sorted({row["seed"] for row in flown}) == [SPLITS["test"].start + n for n in (4, 5, 6)]
    captured = capsys.readouterr()
    assert captured.out == f"{out}: {len(flown):,} steps of 3 flights over 3 maps\n"
    assert captured.err == ""


@pytest.mark.parametrize(
    ("arguments", "allowed"),
    [
        (["--maps", "0"], "at least 1"),
        (["--epsilon", "2"], "0 to 1"),
        (["--split", "exam"], "test, train, validation"),
        (["--formats", "csv"], "minari, parquet"),
        (["--formats"], "formats"),
        (["--reward-profile", "generous"], "aligned, composite, score, tiered"),
    ],
)
def test_the_command_says_what_is_allowed(
    arguments: list[str], allowed: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["dataset", "--out", str(tmp_path / "set"), *arguments]) == 2
    assert allowed in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
