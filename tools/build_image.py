"""Build the container and record it: python tools/build_image.py --builder docker --tag drone-env.

Each build, completed or failed, becomes a record at the end of `data/docker_build.log`.
"""

import argparse
import os
import platform
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path

ROOT = Path(__file__).parents[1]
LOG = ROOT / "data" / "docker_build.log"
BUILDERS = ("docker", "podman", "buildah")
MACHINES = {"x86_64": "amd64", "aarch64": "arm64"}
"""How containers call what Linux calls the machine."""


def build(builder: str, tag: str, context: Path, log: Path, options: Sequence[str]) -> int:
    """Build an image and record how that went.

    Args:
        builder: One of `BUILDERS`.
        tag: The image's name.
        context: The folder to build, with its Dockerfile.
        log: File to append the record to; created if necessary.
        options: More options of the builder's `build`.

    Returns:
        The builder's exit status; 130 if it was interrupted.
    """
    # The form of images that is the default of the other two has no place for a HEALTHCHECK.
    form = [] if builder == "docker" else ["--format", "docker"]
    command = [builder, "build", "--tag", tag, *form, *options, str(context)]
    commit = revision(context)
    started = time.monotonic()
    status = stoppable(command)
    seconds = time.monotonic() - started
    built = status == 0
    append(log, record(built, seconds, commit, image_platform(builder, tag, built), name(builder)))
    print(f"{'COMPLETED' if built else 'FAILED'} after {duration(seconds)}, recorded in {log}", flush=True)
    return status


def stoppable(command: list[str]) -> int:
    """Run a command, and end it when this process gets a signal to stop; its exit status, 130 if it was stopped."""
    running: subprocess.Popen[bytes] | None = None
    stopped = False

    # No exception: one that comes while the command is being started would leave it running.
    def stop(*_: object) -> None:
        nonlocal stopped
        stopped = True
        if running is not None:
            running.terminate()

    before = [(number, signal.signal(number, stop)) for number in (signal.SIGINT, signal.SIGTERM)]
    try:
        running = subprocess.Popen(command)
        if stopped:
            running.terminate()
        status = running.wait()
    finally:
        for number, handler in before:
            signal.signal(number, handler)
    return 130 if stopped else status


def record(completed: bool, seconds: float, revision: str, image_platform: str, builder: str) -> str:
    """The record of a build in the log."""
    lines = {
        "BUILD_LOG": "drone_env",
        "STATUS": "COMPLETED" if completed else "FAILED",
        "DURATION": duration(seconds),
        "REVISION": revision,
        "PLATFORM": image_platform,
        "BUILDER": builder,
        "TIMESTAMP": datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M:%S"),
    }
    return "".join(f"{key}: {value}\n" for key, value in lines.items()) + "-" * 40 + "\n"


def append(log: Path, text: str) -> None:
    """Add a text to a file: in one write, so that builds side by side do not mix, and on the disk when this returns."""
    log.parent.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    try:
        os.write(descriptor, text.encode())
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def duration(seconds: float) -> str:
    """Such as `29m 38s`."""
    return f"{int(seconds) // 60}m {int(seconds) % 60}s"


def revision(context: Path) -> str:
    """The commit that is built, `-dirty` where files differ from it; `unknown` outside of a git checkout."""
    return output("git", "-C", str(context), "describe", "--always", "--dirty", "--exclude", "*") or "unknown"


def image_platform(builder: str, tag: str, built: bool) -> str:
    """Operating system and architecture of the image, of this machine where there is none."""
    inspect = [builder, "image", "inspect", "--format", "{{.Os}}/{{.Architecture}}", tag]
    if builder == "buildah":
        inspect = [builder, "inspect", "--type", "image", "--format", "{{.OCIv1.OS}}/{{.OCIv1.Architecture}}", tag]
    shown = output(*inspect) if built else ""
    machine = platform.machine()
    return shown or f"{platform.system().lower()}/{MACHINES.get(machine, machine)}"


def name(builder: str) -> str:
    """The builder: Docker's context, such as `desktop-linux`, or the other's name and version."""
    if builder == "docker":
        return output("docker", "context", "show") or "docker"
    return output(builder, "--version") or builder


def output(*command: str) -> str:
    """What a command prints, stripped; empty if it fails or does not exist."""
    if shutil.which(command[0]) is None:
        return ""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stdout.strip() if done.returncode == 0 else ""


def main(arguments: Sequence[str] | None = None) -> int:
    """Build as the arguments say; the builder's exit status, 2 if there is no builder."""
    parser = argparse.ArgumentParser(
        description="Build the container and record it.",
        epilog="Further options go to the builder's build command.",
        allow_abbrev=False,
    )
    parser.add_argument("--builder", choices=BUILDERS, default="docker", help="what builds (%(default)s)")
    parser.add_argument("--tag", default="drone-env", help="name of the image (%(default)s)")
    parser.add_argument("--context", type=Path, default=ROOT, help="folder to build (this repository)")
    parser.add_argument("--log", type=Path, default=LOG, help="where the build is recorded (%(default)s)")
    given, options = parser.parse_known_args(arguments)
    if shutil.which(given.builder) is None:
        others = ", ".join(name for name in BUILDERS if shutil.which(name)) or "none of them"
        print(
            f"build_image: {given.builder} is not installed; --builder takes {', '.join(BUILDERS)}, here is: {others}",
            file=sys.stderr,
        )
        return 2
    return build(given.builder, given.tag, given.context, given.log, options)


if __name__ == "__main__":
    sys.exit(main())
