"""A flight as a film: the pictures of `draw_picture`, one after each step, as an animated GIF or as MP4."""

from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from drone_env.core.episode import Episode
from drone_env.envs.rendering import FPS, draw_picture
from drone_env.errors import InvalidValueError, needs
from drone_env.files import replacing

SIZE = 480
"""Height of the pictures in pixels."""
STILL = FPS
"""For how many pictures the end is shown."""
SUFFIXES = (".gif", ".mp4")


def check_film(path: Path) -> None:
    """See that a film of this name can be made here.

    Raises:
        InvalidValueError: if its suffix is another than .gif or .mp4, or there is no ffmpeg for .mp4.
        MissingPackageError: if it is .mp4 and imageio-ffmpeg is not installed.
    """
    if path.suffix not in SUFFIXES:
        raise InvalidValueError(f"a film is a file that ends in {' or '.join(SUFFIXES)}, got {path}")
    if path.suffix == ".mp4":
        _ffmpeg()


def save_film(episode: Episode, path: str | Path) -> None:
    """Write the flight so far as a film, 8 steps a second; the file is there whole or not at all.

    Equal flights give equal files where they are GIFs.

    Args:
        episode: A started episode; it is left as it is.
        path: A file in a folder that exists, whose suffix names the format: .gif or .mp4.

    Raises:
        EpisodeError: before the first reset.
        InvalidValueError, MissingPackageError: as `check_film`.
        OSError: if the file cannot be written.
    """
    path = Path(path)
    check_film(path)
    with replacing(path) as temporary:
        (_write_gif if path.suffix == ".gif" else _write_mp4)(pictures_of(episode), temporary)


def pictures_of(episode: Episode) -> Iterator[npt.NDArray[np.uint8]]:
    """Pictures of a flight, uint8[480, width, 3], RGB: at its reset, after each of its steps, and its end for a second.

    Raises:
        EpisodeError: before the first reset.
    """
    again = Episode(episode.task, episode.reward_profile, episode.seed)
    picture = draw_picture(again, SIZE)
    yield picture
    for action in episode.actions:
        again.step(action)
        picture = draw_picture(again, SIZE)
        yield picture
    for _ in range(STILL):
        yield picture


def _write_gif(pictures: Iterator[npt.NDArray[np.uint8]], path: Path) -> None:
    first = Image.fromarray(next(pictures))
    # One set of colours for all: what does not move then stays the same from picture to picture, and costs nothing.
    colours = first.quantize(255, dither=Image.Dither.NONE)
    images = (Image.fromarray(picture) for picture in pictures)
    frames = (image.quantize(palette=colours, dither=Image.Dither.NONE) for image in chain([first], images))
    # GIF counts in hundredths of a second.
    next(frames).save(
        path, "GIF", save_all=True, append_images=frames, duration=10 * round(100 / FPS), loop=0, optimize=True
    )


def _write_mp4(pictures: Iterator[npt.NDArray[np.uint8]], path: Path) -> None:
    first = next(pictures)
    size = first.shape[1], first.shape[0]
    # The name of the temporary file does not show the format.
    film = _ffmpeg().write_frames(
        path, size, fps=FPS, codec="libx264", macro_block_size=2, output_params=["-f", "mp4"], ffmpeg_log_level="error"
    )
    try:
        film.send(None)
        for picture in chain([first], pictures):
            film.send(picture)
    except OSError:  # its message has many lines
        raise OSError("ffmpeg cannot make the film; its own message is above") from None
    film.close()


def _ffmpeg() -> Any:
    """The module imageio-ffmpeg, which brings or finds the program ffmpeg."""
    with needs("video"):
        import imageio_ffmpeg  # pyright: ignore
    library: Any = imageio_ffmpeg
    try:
        library.get_ffmpeg_exe()
    except RuntimeError as error:
        raise InvalidValueError(f"a film that ends in .mp4 needs ffmpeg: {error}") from None
    return library
