"""Train a network: the same as `drone-env train`."""

import sys

from drone_env.cli import main

if __name__ == "__main__":
    sys.exit(main(["train", *sys.argv[1:]]))
