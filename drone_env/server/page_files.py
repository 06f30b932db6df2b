"""The static files of the page.

`make bundle` writes `static/bundle`: one script and one style sheet for Fly, and one script for each other view.
"""

from hashlib import sha256
from pathlib import Path

PAGE = Path(__file__).with_name("static")
ART = Path(__file__).parents[1] / "envs" / "art"
"""Sprites of Gymnasium's renderer and of the page."""
BUNDLE = PAGE / "bundle"


def sources_digest() -> str:
    """Return 16 hexadecimal digits of the content hash of all files but the bundle, which repeats it."""
    digest = sha256()
    for path in [path for folder in (PAGE, ART) for path in sorted(folder.rglob("*.*")) if path.parent != BUNDLE]:
        content = path.read_bytes()
        digest.update(f"{path.name} {len(content)} ".encode() + content)
    return digest.hexdigest()[:16]


if __name__ == "__main__":
    print(sources_digest())
