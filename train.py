"""Train a network: the same as `drone-env train`."""

import sys

try:
    from drone_env.cli import main
except ModuleNotFoundError as error:
    sys.exit(f'train.py: {error.name} is not installed; run: pip install -e ".[train]"')

if __name__ == "__main__":
    sys.exit(main(["train", *sys.argv[1:]]))
