"""Install PyTorch into an environment: the CPU build, which is small, else the build that pip finds.

    .venv/bin/python tools/install_torch.py PYTHON REQUIREMENT

PyTorch's own index has the CPU build. If it cannot be reached within ten seconds, pip installs what its own
configuration offers. Needs uv beside the Python that runs this file.
"""

import os
import subprocess
import sys
from pathlib import Path

HASTE = {"UV_HTTP_CONNECT_TIMEOUT": "4", "UV_HTTP_TIMEOUT": "8", "UV_HTTP_RETRIES": "0"}
SECONDS = 9.0
"""Covers what the timeouts of uv do not, such as a name server that does not answer."""


def is_reached(install: list[str]) -> bool:
    """Return whether a dry run of `uv pip install` finds the CPU build soon."""
    try:
        asked = subprocess.run(
            [*install, "--dry-run", "--no-deps"], env=os.environ | HASTE, capture_output=True, timeout=SECONDS
        )
    except subprocess.TimeoutExpired:
        return False
    return asked.returncode == 0


def main(python: str, requirement: str) -> None:
    """Install PyTorch, and say which build."""
    uv = str(Path(sys.executable).with_name("uv"))
    install = [uv, "pip", "install", "--python", python, "--torch-backend", "cpu", requirement]
    if is_reached(install):
        print(f"Installing {requirement}, the CPU build: downloads about 200 MB", flush=True)
    else:
        print(
            f"Installing {requirement} by pip, because the index of CPU builds cannot be reached. "
            "PyPI's build for Linux contains CUDA and takes 6.5 GB; TORCH=FILE.whl names another.",
            flush=True,
        )
        install = [python, "-m", "pip", "install", "--no-compile", requirement]
    subprocess.run(install, check=True)


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except subprocess.CalledProcessError as error:
        sys.exit(error.returncode)
