"""Maps that were drawn on the page and are kept: each is a task, found by its name, and the file of a city."""

import logging
import re
import threading
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

from drone_env.city.city_file import City, city_text, parse_city
from drone_env.city.city_task import task_of
from drone_env.core.tasks import TaskConfig
from drone_env.errors import CapacityError, InvalidTaskError, StoreError
from drone_env.files import write_text

log = logging.getLogger(__name__)
NAME = re.compile("(?:drone_env.graders:grade_)?(drawn_[0-9a-f]{12})")


def name_of(content: bytes) -> str:
    """The name of a map, which its file decides: whoever draws the same gets the same."""
    return f"drawn_{sha256(content).hexdigest()[:12]}"


def _task_of(city: City, name: str) -> TaskConfig:
    return replace(task_of(city, name), family="drawn")


class DrawnMaps:
    """Keeps maps in files, and finds their tasks again; safe to share between threads and processes.

    They are not among `TASKS`: who does not know a name is not told of it, and thousands are not listed.

    Args:
        folder: Where their files lie; made with the first.
        most: How many are kept.
    """

    def __init__(self, folder: Path, most: int) -> None:
        self._folder, self._most = folder, most
        self._known: dict[str, TaskConfig] = {}
        self._lock = threading.Lock()

    def keep(self, city: City) -> TaskConfig:
        """Keep a map; one that is kept already changes nothing.

        Raises:
            InvalidTaskError: if it cannot be flown.
            CapacityError: if there is no room for another.
            StoreError: if it cannot be written.
        """
        text = city_text(city)
        name = name_of(text.encode())
        with self._lock:
            known = self.find(name)
            if known is not None:
                return known
            task = _task_of(city, name)
            if len(list(self._folder.glob("drawn_*.toml"))) >= self._most:
                message = f"this server keeps {self._most} drawn maps, and has as many: save yours as a file"
                raise CapacityError(message)
            try:
                self._folder.mkdir(parents=True, exist_ok=True)
                write_text(self._file(name), text)
            except OSError as error:
                raise StoreError(f"the map could not be kept: {error.strerror}") from error
            self._known[name] = task
            return task

    def find(self, name: str) -> TaskConfig | None:
        """The task of a map by its id or grader, None where no such map is kept.

        Raises:
            StoreError: if its file cannot be read.
        """
        named = NAME.fullmatch(name)
        if named is None:
            return None
        name = named[1]
        if name not in self._known:
            try:
                content = self._file(name).read_bytes()
            except FileNotFoundError:
                return None
            except OSError as error:
                raise StoreError(f"the map {name!r} could not be read: {error.strerror}") from error
            try:
                task = _task_of(parse_city(content), name) if name_of(content) == name else None
            except InvalidTaskError:
                task = None
            if task is None:
                # Records name the task alone: another map would be flown in its place.
                log.warning("%s is not the map of its name: it is not flown", self._file(name))
                return None
            self._known[name] = task
        return self._known[name]

    def _file(self, name: str) -> Path:
        return self._folder / f"{name}.toml"
