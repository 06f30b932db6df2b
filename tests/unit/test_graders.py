"""Graders: the one formula, by hand, on models and dictionaries."""

from importlib import import_module
from pathlib import Path

import pytest
from pydantic import ValidationError

import check_graders
from drone_env import graders
from drone_env.core.episode import Episode
from drone_env.core.tasks import TASKS
from drone_env.errors import InvalidValueError
from drone_env.graders import GRADERS, grade_easy, grade_hard, grade_medium
from drone_env.models import DroneState


def state_of(task: str, **changes: object) -> dict:
    return {**DroneState.of(Episode(task, seed=0)).model_dump(mode="json"), **changes}


@pytest.mark.feature("E9")
def test_every_task_has_its_grader() -> None:
    assert list(GRADERS) == list(TASKS)
    standard = {"easy_delivery": grade_easy, "medium_delivery": grade_medium, "hard_delivery": grade_hard}
    assert GRADERS | standard == GRADERS
    for grader, level in zip(standard.values(), ("easy", "medium", "hard"), strict=True):
        assert getattr(import_module(f"drone_env.graders.{level}"), f"grade_{level}") is grader
    for task in TASKS.values():
        module, name = task.grader.split(":")
        assert getattr(import_module(module), name) is GRADERS[task.id]
    with pytest.raises(AttributeError, match="grade_expert"):
        graders.grade_expert  # noqa: B018


@pytest.mark.feature("E9")
def test_only_counts_of_the_graders_own_task_are_graded() -> None:
    given = state_of("easy", score=0.99)
    assert grade_easy(given) == grade_easy(DroneState.model_validate(given)) == 0.20  # 0.2 * (0.5 * 1 + 0.5 * 1)
    with pytest.raises(InvalidValueError, match="'easy_delivery' got a state of 'hard_delivery'"):
        grade_easy(state_of("hard"))
    for broken in ({}, {"task_name": "easy_delivery"}):
        with pytest.raises(ValidationError):
            grade_easy(broken)


@pytest.mark.parametrize(
    ("manifest", "complaint"),
    [
        ("tasks: [{id: easy_delivery, grader: 'drone_env.graders:grade_none'}]\ngraders: []", "grade_none"),
        ("tasks: []\ngraders: [{id: 'drone_env.graders:grade_easy'}]", "no task names it"),
        ("[", "cannot read"),
    ],
)
def test_check_graders_fails_on_a_broken_manifest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], manifest: str, complaint: str
) -> None:
    file = tmp_path / "openenv.yaml"
    file.write_text(manifest)
    assert check_graders.main(str(file)) == 1
    output = capsys.readouterr().out
    assert complaint in output
    assert "PASSED" not in output


@pytest.mark.feature("P4")
def test_check_graders_passes_on_the_manifest_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert check_graders.main() == 0
    assert capsys.readouterr().out.splitlines()[-2:] == ["Summary: 3 valid graders found.", "LOCAL CHECK PASSED."]
