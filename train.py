"""Train a network: the same as `drone-env train`."""

import runpy
import sys
from pathlib import Path

try:
    from drone_env.cli import main
except ModuleNotFoundError as error:
    # The package itself cannot be imported.
    command = runpy.run_path(str(Path(__file__).with_name("drone_env") / "errors.py"))["install_command"]("train")
    sys.exit(f"train.py: {error.name} is not installed; run: {command}")

if __name__ == "__main__":
    sys.exit(main(["train", *sys.argv[1:]]))
