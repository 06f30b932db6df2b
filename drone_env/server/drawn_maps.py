"""Maps that were drawn on the page and are kept: each is a task, found by its name, and the file of a city."""

import logging
import os
import re
import threading
import time
from collections import OrderedDict
from contextlib import suppress
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

from drone_env.city.city_file import MAX_FILE, City, parse_city, task_of
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidTaskError, InvalidValueError, StoreError
from drone_env.files import read_file, write_text
from drone_env.server.problems import RequestError

log = logging.getLogger(__name__)
NAME = re.compile("(?:drone_env.graders:grade_)?(drawn_[0-9a-f]{12})")
STEPS_PER_SIDE = 20
"""Bound of steps and battery units per column and row: four times the steps that a map has by default.

A flight costs memory and traffic for each of its steps, which the server stores, sends and copies.
"""
USUAL = 1000
"""Maps that are kept unless the settings say another number."""
SHARE = 10
"""A stranger may keep this fraction of the maps: 1 / SHARE."""
REMEMBERED = 128
"""Tasks that stay in memory."""
USED_SECONDS = 60.0
"""Precision of the time of the last use: a file is not touched more often."""


def name_of(content: bytes) -> str:
    """The name of a map, which its file decides: whoever draws the same gets the same."""
    return f"drawn_{sha256(content).hexdigest()[:12]}"


def drawn_task(city: City, name: str) -> TaskConfig:
    """The task of a city that somebody has drawn.

    Raises:
        InvalidTaskError: if it cannot be flown, or its flights may be longer than a map of its size needs.
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
    """Keeps maps in files, and finds their tasks again; safe to share between threads and processes.

    They are not among `TASKS`: who does not know a name is not told of it, and thousands are not listed. If there is no
    room for another, the map that was not used for longest is forgotten.

    Args:
        folder: Where their files lie; made with the first.
        most: How many are kept. None for `USUAL`, of callers who are no strangers alone.
    """

    def __init__(self, folder: Path, most: int | None) -> None:
        self._folder, self._most = folder, most
        self._known: OrderedDict[str, tuple[TaskConfig, float]] = OrderedDict()
        self._strangers: dict[str, str] = {}
        """Address of the stranger who drew a map, by its name. This process alone knows it, while it runs."""
        self._lock = threading.RLock()

    def keep(self, text: str, task: TaskConfig, stranger: str | None) -> None:
        """Keep a map; one that is kept already changes nothing.

        Args:
            text: The file of its city.
            task: Its task, whose id is `name_of` the text.
            stranger: The address of whoever has drawn it; None for callers that the server trusts.

        Raises:
            RequestError: if no maps are kept.
            StoreError: if it cannot be written.
        """
        name = task.id
        with self._lock:
            if self.find(name) is not None:
                return
            most = self._most if self._most is not None else USUAL if stranger is None else 0
            if most == 0:
                detail = "this server keeps no drawn maps: save yours as a file, and fly it on a server of your own"
                raise RequestError(403, "maps_off", f"{detail} (drone-env serve), or set DRONE_ENV_MAPS on this one")
            try:
                self._make_room(most, stranger)
                self._folder.mkdir(parents=True, exist_ok=True)
                write_text(self._file(name), text)
            except OSError as error:
                raise StoreError(f"the map could not be kept: {error.strerror}") from error
            if stranger is not None:
                self._strangers[name] = stranger
            self._remember(name, task)

    def find(self, name: str) -> TaskConfig | None:
        """The task of a map by its id or grader, None where no such map is kept.

        Raises:
            StoreError: if its file cannot be read.
        """
        named = NAME.fullmatch(name)
        if named is None:
            return None
        name = named[1]
        with self._lock:
            task, used = self._known.get(name, (None, -USED_SECONDS))
            if task is not None and time.monotonic() - used < USED_SECONDS:
                return task
            try:
                task = task or self._read(name)
                if task is not None:
                    with suppress(PermissionError):  # somebody else's file
                        os.utime(self._file(name))
                    self._remember(name, task)
                return task
            except FileNotFoundError:  # it was never kept, or another process has forgotten it
                self._known.pop(name, None)
                return None
            except OSError as error:
                raise StoreError(f"the map {name!r} could not be read: {error.strerror}") from error

    def _read(self, name: str) -> TaskConfig | None:
        try:
            content = read_file(self._file(name), MAX_FILE)
            if name_of(content) == name:
                return drawn_task(parse_city(content), name)
        except InvalidValueError:
            pass
        # Records name the task alone: another map would be flown in its place.
        log.warning("%s is not the map of its name: it is not flown", self._file(name))
        return None

    def _remember(self, name: str, task: TaskConfig) -> None:
        self._known[name] = task, time.monotonic()
        self._known.move_to_end(name)
        while len(self._known) > REMEMBERED:
            self._known.popitem(last=False)

    def _make_room(self, most: int, stranger: str | None) -> None:
        """Forget maps until there is room for another: a stranger's own if that has its share of the places."""
        used = {file.stem: file.stat().st_mtime_ns for file in self._folder.glob("drawn_*.toml")}
        self._strangers = {name: whose for name, whose in self._strangers.items() if name in used}
        own = [name for name, whose in self._strangers.items() if whose == stranger]
        too_many = len(own) - max(1, most // SHARE) + 1
        names, count = (own, too_many) if stranger is not None and too_many > 0 else (used, len(used) - most + 1)
        for name in sorted(names, key=used.__getitem__)[: max(0, count)]:
            self._file(name).unlink(missing_ok=True)
            self._known.pop(name, None)

    def _file(self, name: str) -> Path:
        return self._folder / f"{name}.toml"
