"""Let a language model fly: the same as `drone-env infer`."""

import runpy
import sys
from pathlib import Path

try:
    from drone_env.cli import main
except ModuleNotFoundError as error:
    installer = runpy.run_path(str(Path(__file__).with_name("drone_env") / "installer.py"))
    sys.exit(f"inference.py: {installer['missing'](error, 'llm')}")

if __name__ == "__main__":
    sys.exit(main(["infer", *sys.argv[1:]]))
