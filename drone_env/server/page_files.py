"""The static files of the page. URLs under `/static/v-EDITION/` contain a content hash, so browsers cache them.

`make bundle` writes `static/bundle`: one script and one style sheet for Fly, and one script for each other view.
"""

import os
import re
from hashlib import sha256
from pathlib import Path

from fastapi.staticfiles import StaticFiles
from starlette.responses import Response
from starlette.types import Scope

PAGE = Path(__file__).with_name("static")
ART = Path(__file__).parents[1] / "envs" / "art"
"""Sprites of Gymnasium's renderer and of the page."""
BUNDLE = PAGE / "bundle"
VERSIONED = re.compile("v-[0-9a-f]{16}/")


def sources_digest() -> str:
    """Return 16 hexadecimal digits of the content hash of all files but the bundle, which repeats it."""
    digest = sha256()
    for path in [path for folder in (PAGE, ART) for path in sorted(folder.rglob("*.*")) if path.parent != BUNDLE]:
        content = path.read_bytes()
        digest.update(f"{path.name} {len(content)} ".encode() + content)
    return digest.hexdigest()[:16]


def edition() -> str:
    """Return the digest of the sources of the bundle, its first line."""
    with (BUNDLE / "main.js").open(encoding="utf-8") as file:
        return file.readline().removeprefix("// ").strip()


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
            response.headers["Cache-Control"] = "max-age=31536000, immutable"
        return response


if __name__ == "__main__":
    print(sources_digest())
