"""Train a network: the same as `drone-env train`."""

import runpy
import sys
from pathlib import Path

try:
    from drone_env.cli import main
except ModuleNotFoundError as error:
    installer = runpy.run_path(str(Path(__file__).with_name("drone_env") / "installer.py"))
    sys.exit(f"train.py: {installer['missing'](error, 'train')}")

if __name__ == "__main__":
    sys.exit(main(["train", *sys.argv[1:]]))
