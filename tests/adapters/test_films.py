"""Films by Gymnasium's recorder, which needs MoviePy."""

import subprocess
from pathlib import Path

import gymnasium
import imageio_ffmpeg
import numpy as np

from drone_env.core.episode import Episode
from drone_env.envs.rendering import FPS, draw_picture

EASY = "drone_env:DroneDelivery-Easy-v1"
WAITS = 4
"""How many steps are flown, of which none ends an episode."""


def assert_shows(path: Path, wanted: list[np.ndarray]) -> None:
    """See that a film holds these pictures, but for what its compression changes, and 8 of them a second."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    read = subprocess.run(command, capture_output=True, check=True)
    assert f" {FPS} fps" in read.stderr.decode()
    shown = np.frombuffer(read.stdout, np.uint8).reshape(-1, *wanted[0].shape).astype(int)
    assert len(shown) == len(wanted)
    assert np.abs(shown - wanted).mean(axis=(1, 2, 3)).max() < 4


def waiting(seed: int, size: int) -> list[np.ndarray]:
    """Pictures of a flight that waits."""
    episode = Episode("easy", seed=seed)
    drawn = [draw_picture(episode, size)]
    for _ in range(WAITS):
        episode.step(4)
        drawn.append(draw_picture(episode, size))
    return drawn


def test_gymnasiums_recorder_of_one(tmp_path: Path) -> None:
    env = gymnasium.wrappers.RecordVideo(gymnasium.make(EASY, render_mode="rgb_array"), str(tmp_path / "films"))
    env.reset(seed=7)
    for _ in range(WAITS):
        env.step(4)
    env.close()
    (made,) = (tmp_path / "films").glob("*.mp4")
    assert_shows(made, waiting(7, 720))
