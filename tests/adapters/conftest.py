"""The scripted endpoints are those of the tests of language models."""

import os

from tests.llm.conftest import endpoint, scripted_server

__all__ = ["endpoint", "scripted_server"]

# Ray reads it when it is imported, which TorchRL does before the cluster's own code says it.
os.environ.setdefault("RAY_AUTH_MODE", "token")
