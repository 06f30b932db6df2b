"""Films by Gymnasium's recorder, which needs MoviePy."""

from pathlib import Path

import gymnasium
import imageio_ffmpeg
import pytest

from drone_env.envs.rendering import FPS


def test_gymnasiums_recorder_films_each_step(tmp_path: Path) -> None:
    env = gymnasium.make("drone_env:DroneDelivery-Easy-v1", render_mode="rgb_array")
    env = gymnasium.wrappers.RecordVideo(env, str(tmp_path / "films"))
    env.reset(seed=7)
    for _ in range(4):
        env.step(4)
    env.close()
    (film,) = (tmp_path / "films").glob("*.mp4")
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(film)
    assert (frames, frames / seconds) == (5, pytest.approx(FPS, rel=0.05))
