"""The lock agrees with pyproject.toml, and both agree with the packages that `pip install -e ".[dev]"` installed."""

from importlib.metadata import PackageNotFoundError, version

import pytest
from packaging.requirements import Requirement

from drone_env.errors import DISTRIBUTION
from tests.package.extras import PROJECT, pins
from tests.tools import find_tool, missing_tool, ran


@pytest.mark.feature("P5")
def test_the_lock_agrees_with_pyproject_toml_and_with_what_is_installed() -> None:
    checked = ran(find_tool("uv"), "lock", "--check", "--offline")
    assert checked.returncode == 0, checked.stderr
    locked = pins("dev")
    extras = PROJECT["optional-dependencies"]
    needed = [Requirement(line) for line in (*PROJECT["dependencies"], *extras["dev"])]
    compared = set()
    for requirement in needed:
        if requirement.name == DISTRIBUTION:
            needed.extend(Requirement(line) for extra in sorted(requirement.extras) for line in extras[extra])
        elif requirement.marker is None or requirement.marker.evaluate():
            (pin,) = locked[requirement.name].specifier
            assert pin.version in requirement.specifier, requirement
            try:
                # These tests run in what `pip install -e ".[dev]"` made, or in what uv made without the large packages.
                assert version(requirement.name) in requirement.specifier, requirement
            except PackageNotFoundError:
                missing_tool(requirement.name)
            compared.add(requirement.name)
    assert {"numpy", "fastapi", "torch", "ray", "pytest"} <= compared
