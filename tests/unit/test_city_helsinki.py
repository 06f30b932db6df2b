"""The centre of Helsinki: from the extract to the file, and what is wrong with an extract."""

from pathlib import Path

import pytest

from drone_env.cli import main

HELSINKI = Path(__file__).parents[2] / "examples" / "cities" / "helsinki.osm.pbf"


def made(source: Path, out: Path, *more: str) -> Path:
    assert main(["city", str(source), "--out", str(out), *more]) == 0
    return out


def test_an_extract_becomes_a_file_and_is_summed_up(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    first = made(HELSINKI, tmp_path / "a.toml").read_text(encoding="utf-8")
    printed = capfd.readouterr().out
    assert f"{tmp_path / 'a.toml'}: 63 x 64 cells of 16 metres\n--bbox 24.9" in printed
    assert "© OpenStreetMap contributors, ODbL-1.0" in printed
    assert [path.name for path in tmp_path.iterdir()] == ["a.toml"]
    assert 'attribution = "© OpenStreetMap contributors, ODbL-1.0"' in first


WRONG: dict[str, tuple[str, bytes, str, str]] = {
    "a far place": ("town.osm.pbf", HELSINKI.read_bytes(), "--bbox 2 48 2.01 48.005", "no layer has anything there"),
    "too many cells": ("town.osm.pbf", HELSINKI.read_bytes(), "--bbox 24.93 60.16 24.96 60.18", "--size allows"),
    "a size of nothing": ("town.osm.pbf", b"x", "--size 64 1", "two numbers of 2 to 512, got 64 1"),
    "a city of another kind": ("town.osm.pbf", b"x", "--out town.json", "a file that ends in .toml"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_said_and_nothing_is_written(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    name, content, more, said = WRONG[case]
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_bytes(content)
    before = sorted(tmp_path.iterdir())
    assert main(["city", name, "--out", "town.toml", *more.split()]) == 2
    error = capfd.readouterr().err
    assert said in error
    assert error.startswith("drone-env: ")
    assert error.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before
