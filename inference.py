"""Let a language model fly: the same as `drone-env infer`."""

import runpy
import sys
from pathlib import Path

try:
    from drone_env.cli import main
except ModuleNotFoundError as error:
    # The package itself cannot be imported.
    command = runpy.run_path(str(Path(__file__).with_name("drone_env") / "errors.py"))["install_command"]("llm")
    sys.exit(f"inference.py: {error.name} is not installed; run: {command}")

if __name__ == "__main__":
    sys.exit(main(["infer", *sys.argv[1:]]))
