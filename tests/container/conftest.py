"""The server is that of the tests of the API."""

from tests.api.conftest import server

__all__ = ["server"]
