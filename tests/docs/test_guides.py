"""The documents that were promised: the licence and the guides."""

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
