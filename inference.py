"""Let a language model fly: the same as `drone-env infer`."""

import sys

from drone_env.cli import main

if __name__ == "__main__":
    sys.exit(main(["infer", *sys.argv[1:]]))
