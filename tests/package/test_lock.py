"""The lock agrees with pyproject.toml."""

import pytest

from tests.tools import find_tool, ran


@pytest.mark.feature("P5")
def test_the_lock_agrees_with_pyproject_toml() -> None:
    checked = ran(find_tool("uv"), "lock", "--check", "--offline")
    assert checked.returncode == 0, checked.stderr
