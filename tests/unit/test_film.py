"""Flights as films."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

from drone_env.cli import main
from drone_env.core.episode import Episode
from drone_env.envs.film import SIZE, save_film
from drone_env.envs.rendering import draw_picture

ACTIONS = (0, 0, 3, 4, 1)


def test_a_gif_shows_the_start_and_every_step_and_rests_at_the_end(tmp_path: Path) -> None:
    save_film(Episode("easy", seed=7).fly(ACTIONS), tmp_path / "flight.gif")
    again = Episode("easy", seed=7)
    wanted = [draw_picture(again, SIZE)]
    for action in ACTIONS:
        again.step(action)
        wanted.append(draw_picture(again, SIZE))
    with Image.open(tmp_path / "flight.gif") as gif:
        frames = ImageSequence.Iterator(gif)
        shown = [np.asarray(frame.convert("RGB"), float) for frame in frames]
    for picture, want in zip(shown, wanted, strict=True):
        differs = [np.abs(picture - other).mean() for other in wanted]
        assert min(differs) == np.abs(picture - want).mean() < 2  # in 255 colours


def test_fly_and_replay_save_the_same_film(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second, record = (tmp_path / name for name in ("films/first.gif", "second.gif", "flight.json"))
    assert main(["fly", "--task", "easy", "--seed", "14", "--video", str(first), "--record", str(record)]) == 0
    flown = capsys.readouterr()
    assert f"video: {first}" in flown.err
    assert main(["replay", str(record), "--video", str(second)]) == 0
    assert capsys.readouterr().out == flown.out
    assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize(
    ("video", "why"),
    [
        ("flight.mp4", "a film must be a file that ends in .gif, got flight.mp4"),
        ("folder.gif", "--video takes the name of a file, got the folder folder.gif"),
    ],
)
def test_a_film_that_cannot_be_made_is_said_before_the_flight(
    video: str, why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("folder.gif").mkdir()
    assert main(["fly", "--task", "easy", "--seed", "14", "--video", video]) == 2
    captured = capsys.readouterr()
    assert why in captured.err
    assert captured.out == ""
    assert [file.name for file in tmp_path.iterdir()] == ["folder.gif"]
