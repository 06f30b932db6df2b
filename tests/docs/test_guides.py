"""The documents that were promised: the licence and the guides."""

import subprocess

import pytest

from tests.docs.pages import ROOT


def text_of(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


@pytest.mark.feature("P7")
def test_the_licence_and_the_guides() -> None:
    assert text_of("LICENSE").startswith("MIT License")
    assert "make test" in text_of("CONTRIBUTING.md")
    assert "MIT licence" in text_of("README.md")
    assert "push `build/space`, not this repository" in text_of("README.md")
    guide = text_of("docs/deployment.md")
    assert "openenv push" in guide
    assert "git push" in guide


def test_the_demo_ends_by_naming_what_serves_and_that_brings_its_extra() -> None:
    def typed(target: str) -> list[str]:
        dry = ["make", "--no-print-directory", "-n", "--always-make", target]
        return subprocess.run(dry, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()

    assert "make serve, then open http://127.0.0.1:8000" in typed("demo")[-1]
    *before, last = typed("serve")
    assert any("'.[server]'" in line for line in before)
    assert last.split()[0].endswith("drone-env")
