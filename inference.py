"""Let a language model fly: the same as `drone-env infer`."""

import sys

try:
    from drone_env.cli import main
except ModuleNotFoundError as error:
    sys.exit(f'inference.py: {error.name} is not installed; run: pip install -e ".[llm]"')

if __name__ == "__main__":
    sys.exit(main(["infer", *sys.argv[1:]]))
