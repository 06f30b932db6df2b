"""The static files of the page. URLs under `/static/v-EDITION/` contain a content hash, so browsers cache them.

`make bundle` writes `static/bundle`: one script and one style sheet for Fly, and one script for each other view.
"""

import os
import re
from functools import lru_cache
from hashlib import sha256
from pathlib import Path

from fastapi.staticfiles import StaticFiles
from starlette.responses import Response
from starlette.types import Scope

PAGE = Path(__file__).with_name("static")
ART = Path(__file__).parents[1] / "envs" / "art"
"""Sprites of Gymnasium's renderer and of the page."""
FILES = [(folder, path) for folder in (PAGE, ART) for path in sorted(folder.rglob("*.*"))]
SOURCES = [PAGE / "index.html", *sorted(PAGE.glob("css/*.css")), *sorted(PAGE.glob("js/*.js"))]
BUNDLE = PAGE / "bundle" / "main.js"
PATHS = {f"/static/{path.relative_to(folder).as_posix()}" for folder, path in FILES}
VERSIONED = re.compile("v-[0-9a-f]{16}/")
FOREVER = "max-age=31536000, immutable"


def edition() -> str:
    """Return 16 hexadecimal digits of the content hash of all files."""
    return _digest(tuple(path for _, path in FILES))


def sources_digest() -> str:
    """Return 16 hexadecimal digits of the content hash of the bundle's sources, which its first line repeats."""
    return _digest(tuple(SOURCES))


def is_bundled() -> bool:
    """Return whether the bundle is current: no source has changed since `make bundle`."""
    with BUNDLE.open(encoding="utf-8") as file:
        return file.readline().split() == ["//", sources_digest()]


def _digest(paths: tuple[Path, ...]) -> str:
    status = [path.stat() for path in paths]
    return _digest_once(paths, tuple((one.st_mtime_ns, one.st_size) for one in status))


@lru_cache(maxsize=2)
def _digest_once(paths: tuple[Path, ...], _changed: tuple[tuple[int, int], ...]) -> str:
    """Compute the hash. Cached until a file changes."""
    digest = sha256()
    for path in paths:
        content = path.read_bytes()
        digest.update(f"{path.name} {len(content)} ".encode() + content)
    return digest.hexdigest()[:16]


def is_file(path: str) -> bool:
    """Return whether this is the path of a file of the page, with or without an edition."""
    return VERSIONED.sub("", path, count=1) in PATHS


class PageFiles(StaticFiles):
    """Serves the files of the page. Browsers cache those of the current edition."""

    def __init__(self) -> None:
        super().__init__(directory=PAGE, packages=[("drone_env.envs", ART.name)])

    def get_path(self, scope: Scope) -> str:
        """Return the path of a file within its folder."""
        return VERSIONED.sub("", super().get_path(scope), count=1)

    def file_response(
        self, full_path: str | os.PathLike[str], stat_result: os.stat_result, scope: Scope, status_code: int = 200
    ) -> Response:
        """Return the response. A page of an older edition gets the current file, uncached."""
        response = super().file_response(full_path, stat_result, scope, status_code)
        if f"/v-{edition()}/" in scope["path"]:
            response.headers["Cache-Control"] = FOREVER
        return response


if __name__ == "__main__":
    print(sources_digest())
