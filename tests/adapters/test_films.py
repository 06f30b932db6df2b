"""Films by the recorders of Gymnasium and Stable-Baselines3, which need MoviePy, and our own as MP4."""

import subprocess
from pathlib import Path

import gymnasium
import imageio_ffmpeg
import numpy as np
import pytest
from stable_baselines3.common.vec_env import VecVideoRecorder
from stable_baselines3.common.vec_env.base_vec_env import tile_images

from drone_env.cli import main
from drone_env.core.episode import Episode
from drone_env.envs import film, vector
from drone_env.envs.rendering import FPS, draw_picture
from drone_env.envs.sb3 import DroneDeliveryVecEnv

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


def test_gymnasiums_recorder_of_many(tmp_path: Path) -> None:
    batch = gymnasium.make_vec(EASY, num_envs=2, render_mode="rgb_array")
    env = gymnasium.wrappers.vector.RecordVideo(batch, str(tmp_path / "films"), video_aspect_ratio=(3, 1))
    env.reset(seed=7)
    for _ in range(WAITS):
        env.step(np.full(2, 4))
    env.close()
    (made,) = (tmp_path / "films").glob("*.mp4")
    pairs = zip(waiting(7, vector.SIZE), waiting(8, vector.SIZE), strict=True)
    assert_shows(made, [np.concatenate(pair, axis=1) for pair in pairs])


def test_sb3s_recorder(tmp_path: Path) -> None:
    drones = DroneDeliveryVecEnv("easy", 2, render_mode="rgb_array")
    env = VecVideoRecorder(drones, str(tmp_path), lambda step: step == 0, video_length=WAITS)
    env.seed(7)
    env.reset()
    for _ in range(WAITS):
        env.step(np.full(2, 4))
    env.close()
    (made,) = tmp_path.glob("*.mp4")
    pairs = zip(waiting(7, vector.SIZE), waiting(8, vector.SIZE), strict=True)
    assert_shows(made, [tile_images(pair) for pair in pairs])


def test_fly_as_mp4(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = tmp_path / "flight.mp4"
    assert main(["fly", "--task", "easy", "--seed", "14", "--agent", "greedy", "--video", str(made)]) == 0
    flown = Episode("easy", seed=14).fly([2, 0, 0])
    assert_shows(made, list(film.pictures_of(flown)))
    assert [file.name for file in tmp_path.iterdir()] == ["flight.mp4"]
