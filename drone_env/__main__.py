"""`python -m drone_env`: the same as `drone-env`."""

import sys

from drone_env.cli import main

if __name__ == "__main__":
    sys.exit(main())
