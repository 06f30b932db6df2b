"""A flight as an animated GIF: one picture of `draw_picture` after each step."""

from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from drone_env.core.episode import Episode
from drone_env.envs.rendering import FPS, draw_picture
from drone_env.errors import InvalidValueError
from drone_env.files import replacing

SIZE = 480
"""Height of the pictures in pixels."""


def check_film(path: Path) -> None:
    """Check the suffix of the file.

    Raises:
        InvalidValueError: if it is not .gif.
    """
    if path.suffix != ".gif":
        raise InvalidValueError(f"a film must be a file that ends in .gif, got {path}")


def save_film(episode: Episode, path: str | Path) -> None:
    """Write the flight so far as a GIF with 8 steps a second. Equal flights give equal files.

    The file is replaced as a whole, so it is never incomplete.

    Args:
        episode: A started episode; it is not changed.
        path: A file that ends in .gif, in an existing folder.

    Raises:
        EpisodeError: before the first reset.
        InvalidValueError: if the suffix is not .gif.
        OSError: if the file cannot be written.
    """
    path = Path(path)
    check_film(path)
    pictures = pictures_of(episode)
    first = Image.fromarray(next(pictures))
    # A shared palette keeps unchanged areas equal from frame to frame, so that they compress well.
    palette = first.quantize(255, dither=Image.Dither.NONE)
    images = chain([first], (Image.fromarray(picture) for picture in pictures))
    frames = (image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images)
    duration = 10 * round(100 / FPS)  # milliseconds; GIF stores hundredths of a second
    with replacing(path) as temporary:
        next(frames).save(
            temporary, "GIF", save_all=True, append_images=frames, duration=duration, loop=0, optimize=True
        )


def pictures_of(episode: Episode) -> Iterator[npt.NDArray[np.uint8]]:
    """Yield a picture after the reset, one after each step, and the last one for a second: uint8[480, width, 3].

    Raises:
        EpisodeError: before the first reset.
    """
    replayed = Episode(episode.task, episode.reward_profile, episode.seed)
    picture = draw_picture(replayed, SIZE)
    yield picture
    for action in episode.actions:
        replayed.step(action)
        picture = draw_picture(replayed, SIZE)
        yield picture
    for _ in range(FPS):
        yield picture
