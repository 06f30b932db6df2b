"""Tables on terminals of any width, and in a pipe."""

import re
import sys

import pytest

from drone_env.results.tables import Table, print_table

HEAD = ("task", "agent", "score (95 %)", "optimum", "ratio", "success", "steps")
ROWS = [
    ("skyline_hard v2", agent, "0.0400 [0.0100, 0.0852]", "0.9455", "0.0423", "0.0%", "18.5")
    for agent in ("greedy", "my_agents.module:chase")
]


@pytest.mark.parametrize("width", [None, 120, 80, 60])
def test_a_table_fits_the_terminal_and_cuts_no_cell(
    width: int | None, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if width is not None:
        monkeypatch.setenv("TERM", "xterm")
        monkeypatch.setenv("COLUMNS", f"{width}")
        monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    print_table(Table("Scores", HEAD, ROWS), names=2)
    printed = re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out)
    assert max(map(len, printed.splitlines())) <= (width or 120)
    rule = next(i for i, line in enumerate(printed.splitlines()) if "──" in line)
    heading, rows = ("\n".join(part) for part in (printed.splitlines()[:rule], printed.splitlines()[rule:]))
    assert [name for name in HEAD if name not in heading] == []
    assert [rows.count(cell) for cell in ("skyline_hard v2", "my_agents.module:chase", *ROWS[0][2:])] == [2, 1] + [
        2
    ] * 5
    assert (len(rows.splitlines()) == 4) == (width in (None, 120))  # wide enough for a line a row
