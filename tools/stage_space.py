"""Stage the folder that becomes a Hugging Face Space: python tools/stage_space.py [FOLDER].

It holds what the container is built from, and the files of `space/`: the Space's page, and what `openenv push` and the
Hub's git look for at the root.
"""

import argparse
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
STAGED = ROOT / "build" / "space"
PARTS = (
    ".dockerignore",
    "Dockerfile",
    "LICENSE",
    "drone_env",
    "inference.py",
    "openenv.yaml",
    "pyproject.toml",
    "server",
    "uv.lock",
    "validation",
)
MARK = ".staged"
"""Marks a folder as one that this command made, and may replace."""
IN_A_SPACE = """
# Only Hugging Face's proxy reaches the Space, from a private address, and says whether the visitor came by HTTPS.
# Browsers keep the session's cookie in the frame of another site only if it is marked for HTTPS. Proxies append to
# X-Forwarded-For, so the visitor is the last public address; visitors can send the first ones themselves.
ENV FORWARDED_ALLOW_IPS=10.0.0.0/8,100.64.0.0/10,127.0.0.0/8,169.254.0.0/16,172.16.0.0/12,192.168.0.0/16,::1,fc00::/7
"""


def stage(folder: Path, root: Path = ROOT) -> list[Path]:
    """Write a Space's files into a folder; what stood there from an earlier staging is replaced, but for `.git`.

    Args:
        folder: Where to.
        root: The repository.

    Returns:
        The staged files, relative to the folder, sorted.

    Raises:
        FileNotFoundError: if the repository lacks one of the parts.
        FileExistsError: if the folder holds something that was not staged there.
    """
    clear(folder)
    (folder / MARK).touch()
    junk = shutil.ignore_patterns("__pycache__", "*.pyc")
    for part in PARTS:
        source, target = root / part, folder / part
        if source.is_dir():
            shutil.copytree(source, target, ignore=junk)
        else:
            shutil.copy2(source, target)
    shutil.copytree(root / "space", folder, ignore=junk, dirs_exist_ok=True)
    with (folder / "Dockerfile").open("a", encoding="utf-8") as dockerfile:
        dockerfile.write(IN_A_SPACE)
    files = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return sorted(file for file in files if file.parts[0] not in (".git", MARK))


def clear(folder: Path) -> None:
    """Make a folder, or empty it of what was staged before.

    Raises:
        FileExistsError: if it holds something that was not staged there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    found = [path for path in folder.iterdir() if path.name != ".git"]
    if found and not (folder / MARK).exists():
        raise FileExistsError(f"{folder} is not empty, and was not staged by this command; name another folder")
    for path in found:
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()


def main(arguments: Sequence[str] | None = None) -> int:
    """Stage as the arguments say; 2 if that cannot be done."""
    parser = argparse.ArgumentParser(description="Stage the folder that becomes a Hugging Face Space.")
    parser.add_argument("folder", type=Path, nargs="?", default=STAGED, help="where to (build/space)")
    given = parser.parse_args(arguments)
    try:
        files = stage(given.folder)
    except OSError as error:
        print(f"stage_space: {error}", file=sys.stderr)
        return 2
    size = sum((given.folder / file).stat().st_size for file in files)
    print(f"{len(files)} files, {size / 1e6:.1f} MB, staged in {given.folder}")
    print(f"next: openenv push {given.folder} --repo-id USER/NAME   (docs/deployment.md)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
