"""Stored maps that people drew on the page: each is the file of a city, and a task with the name of the file."""

import re
from dataclasses import replace
from functools import lru_cache
from hashlib import sha256
from pathlib import Path

from drone_env.city.city_file import MAX_FILE, City, parse_city, task_of
from drone_env.core.tasks import TaskConfig
from drone_env.errors import StoreError
from drone_env.files import read_file, write_text

NAME = re.compile("(?:drone_env.graders:grade_)?(drawn_[0-9a-f]{12})")


def name_of(content: bytes) -> str:
    """The name of a map, a digest of its file: equal drawings have equal names."""
    return f"drawn_{sha256(content).hexdigest()[:12]}"


def drawn_task(city: City, name: str) -> TaskConfig:
    """The task of a drawn city.

    Raises:
        InvalidTaskError: if it is not a valid task.
    """
    return replace(task_of(city, name), family="drawn")


class DrawnMaps:
    """Stores maps in files and finds their tasks; safe to share between threads and processes.

    The maps are not in `TASKS`: a caller needs to know the name.

    Args:
        folder: The folder of the files; created with the first one.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._read = lru_cache(maxsize=128)(_read)

    def keep(self, text: str, name: str) -> None:
        """Store the file of a city under its name, `name_of` the text.

        Raises:
            StoreError: if the map cannot be written.
        """
        try:
            write_text(self._file(name), text)
        except OSError as error:
            raise StoreError(f"the map could not be stored: {error.strerror}") from error

    def find(self, name: str) -> TaskConfig | None:
        """The task of a map by its id or grader, None if there is no such map."""
        match = NAME.fullmatch(name)
        if match is None or not self._file(match[1]).exists():
            return None
        return self._read(self._file(match[1]))

    def _file(self, name: str) -> Path:
        return self._folder / f"{name}.toml"


def _read(file: Path) -> TaskConfig:
    return drawn_task(parse_city(read_file(file, MAX_FILE)), file.stem)
