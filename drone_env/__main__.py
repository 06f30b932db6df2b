"""`python -m drone_env`: the same as `drone-env`."""

import sys

from drone_env.errors import needs

if __name__ == "__main__":
    with needs("", __name__):
        from drone_env.cli import main
    sys.exit(main())
