"""Tables on terminals of any width, and in a pipe."""

import re
import sys

import pytest

from drone_env.results.tables import Table, markdown, print_table

HEAD = ("task", "agent", "score (95 %)", "optimum", "ratio", "success", "steps")
ROW = ("skyline_hard v2", "my_agents.module:chase", "0.0400 [0.0100, 0.0852]", "0.9455", "0.0423", "0.0%", "18.5")


@pytest.mark.parametrize("width", [None, 80])
def test_a_table_fits_the_terminal_and_cuts_no_cell(
    width: int | None, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if width is not None:
        monkeypatch.setenv("TERM", "xterm")
        monkeypatch.setenv("COLUMNS", f"{width}")
        monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    print_table(Table("Scores", HEAD, [ROW]), names=2)
    printed = re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out)
    assert max(map(len, printed.splitlines())) <= (width or 120)
    _, _, below = printed.partition("──")
    assert sorted("".join(below.split())) == sorted("".join("".join(ROW).split()) + "─" * below.count("─"))
    assert (len(below.splitlines()) == 3) == (width is None)  # wide enough for a line a row


def test_a_name_with_a_bar_stays_one_cell_of_markdown() -> None:
    assert markdown([["agent"], ["fly|me"]]) == "| agent |\n|---|\n| fly\\|me |"
