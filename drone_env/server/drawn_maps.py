"""Stored maps that people drew on the page: each is the file of a city, and a task with the name of the file."""

import logging
import os
import re
import threading
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from hashlib import sha256
from pathlib import Path

from drone_env.city.city_file import MAX_FILE, City, parse_city, task_of
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidTaskError, InvalidValueError, StoreError
from drone_env.files import read_file, write_text
from drone_env.server.exceptions import RequestError

log = logging.getLogger(__name__)
NAME = re.compile("(?:drone_env.graders:grade_)?(drawn_[0-9a-f]{12})")
STEPS_PER_SIDE = 20
"""Maximum number of steps and battery units per column and row: four times the default.

The bound limits memory and traffic: the server stores, sends and copies each step of a flight.
"""
DEFAULT_MAPS = 1000
"""Maximum number of stored maps, unless the settings set another."""


def name_of(content: bytes) -> str:
    """The name of a map, a digest of its file: equal drawings have equal names."""
    return f"drawn_{sha256(content).hexdigest()[:12]}"


def drawn_task(city: City, name: str) -> TaskConfig:
    """The task of a drawn city.

    Raises:
        InvalidTaskError: if it is not a valid task, or allows flights that are too long for its size.
    """
    task = replace(task_of(city, name), family="drawn")
    most = STEPS_PER_SIDE * (task.width + task.height)
    for number in ("max_steps", "battery_capacity", "charge_rate"):
        value = getattr(task, number)
        if value > most:
            size = f"{task.width} x {task.height} cells"
            raise InvalidTaskError(f"{number} must be at most {most} on a drawn map of {size}, got {value}")
    return task


class DrawnMaps:
    """Stores maps in files and finds their tasks; safe to share between threads and processes.

    The maps are not in `TASKS`: a caller needs to know the name. If the folder is full, the least recently used map is
    deleted.

    Args:
        folder: The folder of the files; created with the first one.
        most: Maximum number of maps. None for `DEFAULT_MAPS`, but none from strangers.
    """

    def __init__(self, folder: Path, most: int | None) -> None:
        self._folder, self._most = folder, most
        self._read = lru_cache(maxsize=128)(_read)
        self._lock = threading.Lock()

    def keep(self, text: str, task: TaskConfig, trusted: bool) -> None:
        """Store a map, unless it is stored already.

        Args:
            text: The file of its city.
            task: Its task, whose id is `name_of` the text.
            trusted: Whether the caller may store maps without a setting that allows it.

        Raises:
            RequestError: if this server stores no maps.
            StoreError: if the map cannot be written.
        """
        with self._lock:
            if self.find(task.id) is not None:
                return
            most = self._most if self._most is not None else DEFAULT_MAPS if trusted else 0
            if most == 0:
                detail = "this server keeps no drawn maps: save yours as a file, and fly it on a server of your own"
                raise RequestError(403, "maps_off", detail)
            try:
                self._make_room(most)
                self._folder.mkdir(parents=True, exist_ok=True)
                write_text(self._file(task.id), text)
            except OSError as error:
                raise StoreError(f"the map could not be stored: {error.strerror}") from error

    def find(self, name: str) -> TaskConfig | None:
        """The task of a map by its id or grader, None if there is no such map.

        Raises:
            StoreError: if its file cannot be read.
        """
        match = NAME.fullmatch(name)
        if match is None:
            return None
        file = self._file(match[1])
        try:
            with suppress(PermissionError):  # the file of another user
                os.utime(file)  # the time of the last use
            return self._read(file)
        except FileNotFoundError:
            return None
        except InvalidValueError:
            # Records contain only the name, so another map would be flown instead.
            log.warning("%s is ignored: its name is not the digest of its content", file)
            return None
        except OSError as error:
            raise StoreError(f"the map {match[1]!r} could not be read: {error.strerror}") from error

    def _make_room(self, most: int) -> None:
        """Delete the least recently used maps until there is room for another."""
        used = {file: file.stat().st_mtime_ns for file in self._folder.glob("drawn_*.toml")}
        for file in sorted(used, key=used.__getitem__)[: max(0, len(used) - most + 1)]:
            file.unlink(missing_ok=True)

    def _file(self, name: str) -> Path:
        return self._folder / f"{name}.toml"


def _read(file: Path) -> TaskConfig:
    content = read_file(file, MAX_FILE)
    if name_of(content) != file.stem:
        raise InvalidValueError("another map")
    return drawn_task(parse_city(content), file.stem)
