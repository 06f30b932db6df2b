"""Build the container and record it: python tools/build_image.py --builder podman.

Each build, completed or failed, becomes a record at the end of `data/docker_build.log`.
"""

import argparse
import shutil
import subprocess
import sys
import time
from datetime import datetime, timezone
from pathlib import Path

ROOT = Path(__file__).parents[1]
BUILDERS = ("docker", "podman", "buildah")


def output(*command: str) -> str:
    """Return what a command prints, or "unknown" if it fails."""
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.strip() if done.returncode == 0 else "unknown"


def build(builder: str, tag: str, log: Path, options: list[str]) -> int:
    """Build an image, and append a record to a file.

    Args:
        builder: One of `BUILDERS`.
        tag: Name of the image.
        log: The file.
        options: Further options of the builder.

    Returns:
        The exit status of the builder.
    """
    # Only this format has a HEALTHCHECK; Docker has no other.
    form = [] if builder == "docker" else ["--format", "docker"]
    began = time.monotonic()
    status = subprocess.run([builder, "build", "--tag", tag, *form, *options, str(ROOT)], check=False).returncode
    minutes, seconds = divmod(round(time.monotonic() - began), 60)
    record = {
        "BUILD_LOG": "drone_env",
        "STATUS": "FAILED" if status else "COMPLETED",
        "DURATION": f"{minutes}m {seconds}s",
        "REVISION": output("git", "describe", "--always", "--dirty", "--exclude", "*"),
        "PLATFORM": output(builder, "image", "inspect", "--format", "{{.Os}}/{{.Architecture}}", tag),
        "BUILDER": output(builder, "--version"),
        "TIMESTAMP": datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M:%S"),
    }
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("a", encoding="utf-8") as file:
        file.write("".join(f"{key}: {value}\n" for key, value in record.items()) + "-" * 40 + "\n")
    print(f"{record['STATUS']} after {record['DURATION']}, recorded in {log}", flush=True)
    return status


def main() -> int:
    """Return the exit status of the builder, or 2 if it is not installed."""
    parser = argparse.ArgumentParser(
        description="Build the container and record it.",
        epilog="Further options go to the builder.",
        allow_abbrev=False,
    )
    parser.add_argument("--builder", choices=BUILDERS, default="docker", help="what builds (%(default)s)")
    parser.add_argument("--tag", default="drone-env", help="name of the image (%(default)s)")
    parser.add_argument("--log", type=Path, default=ROOT / "data" / "docker_build.log", help="the record (%(default)s)")
    given, options = parser.parse_known_args()
    if shutil.which(given.builder) is None:
        print(f"build_image: {given.builder} is not installed; --builder takes {', '.join(BUILDERS)}", file=sys.stderr)
        return 2
    return build(given.builder, given.tag, given.log, options)


if __name__ == "__main__":
    sys.exit(main())
