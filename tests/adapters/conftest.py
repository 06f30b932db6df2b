"""The scripted endpoints are those of the tests of language models."""

import os
from typing import Any

from tests.docs.pages import ROOT, blocks
from tests.llm.conftest import endpoint, scripted_server

__all__ = ["endpoint", "scripted_server"]

# Ray reads it when it is imported, which TorchRL does before the cluster's own code says it.
os.environ.setdefault("RAY_AUTH_MODE", "token")


def run_example(library: str) -> dict[str, Any]:
    """Run the example of a library on the page about them, and return its names."""
    (block,) = [block for block in blocks(ROOT / "docs" / "libraries.md") if library in (block.not_run or "")]
    names: dict[str, Any] = {"__name__": "__main__"}
    exec(compile(block.text, block.where, "exec"), names)
    return names
