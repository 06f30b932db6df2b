"""The application and the command at the path that OpenEnv's tools expect."""

from drone_env.errors import needs

with needs("server", __name__):
    from drone_env.server import app as server
    from drone_env.server.app import app

__all__ = ["app", "main"]


def main() -> None:
    """Serve until stopped; see `--help`."""
    server.main()


if __name__ == "__main__":
    main()
