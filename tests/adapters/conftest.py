"""The scripted endpoints are those of the tests of language models."""

from tests.llm.conftest import endpoint, scripted_server

__all__ = ["endpoint", "scripted_server"]
