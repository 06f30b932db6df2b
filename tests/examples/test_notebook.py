"""The notebook of examples/: it is sound, and what stands in it is what its cells put out."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from tests.docs import shell
from tests.docs.pages import ROOT
from tools.docs_notebook import NOTEBOOK, SHELL, code_cells, run

CELLS = code_cells(json.loads(NOTEBOOK.read_text(encoding="utf-8")))


def text_of(outputs: list[dict[str, Any]]) -> list[str]:
    """What cells say in text; of pictures that there is one."""
    return ["".join(output.get("text") or output["data"].get("text/plain", "a picture")) for output in outputs]


def shape_of(text: str) -> list[str]:
    """Figures, who is the better, and how wide a table is for them, differ with PyTorch and the processor."""
    for figure, shape in ((r"[-+]?\d+", "0"), (r"\w*…", "…"), ("─", " "), ("; the best so far", "")):
        text = re.sub(figure, shape, text)
    return sorted(text.split())


def test_the_notebook_is_sound_and_small(monkeypatch: pytest.MonkeyPatch) -> None:
    for number, cell in enumerate(CELLS, 1):
        code, where = "".join(cell["source"]), f"{NOTEBOOK.name}, cell {number}"
        if code.startswith(SHELL):
            shell.check(code.removeprefix(SHELL), where, monkeypatch)
        else:
            shell.check_python(code, where)
        assert cell["execution_count"] == number, "run tools/docs_notebook.py"
        assert cell["outputs"]
        assert all(output["output_type"] in ("stream", "execute_result") for output in cell["outputs"])
    assert NOTEBOOK.stat().st_size < 100_000
    for page in ("README.md", "docs/examples.md", "docs/libraries.md", "docs/agents.md"):
        assert f"examples/{NOTEBOOK.name}" in (ROOT / page).read_text(encoding="utf-8")


@pytest.mark.campaign
@pytest.mark.timeout(900)
def test_its_cells_put_out_what_stands_in_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    for cell, outputs in zip(CELLS, run({"cells": CELLS}, tmp_path), strict=True):
        found, kept = text_of(outputs), text_of(cell["outputs"])
        if "learned" in cell["metadata"].get("tags", ()):
            found, kept = [*map(shape_of, found)], [*map(shape_of, kept)]
        assert found == kept, cell["id"]
    assert (tmp_path / "data" / "evaluations" / "ppo" / "evaluation.json").is_file()
