"""tools/mutants.py, on a project of two files, and its table."""

from collections import Counter

from tools.mutants import read_table


def test_the_table_fits_the_files_and_covers_every_part() -> None:
    table = read_table()
    assert [(mutant.id, mutant.by) for mutant in table if mutant.verdict] == []
    parts = Counter(mutant.file.split("/")[1] for mutant in table)
    assert {"core", "planning", "server", "results", "llm", "rl"} <= parts.keys()
    assert len(table) >= 60
    assert sum("/static/js/" in mutant.file for mutant in table) >= 10
