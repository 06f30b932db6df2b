"""The log lines of `drone-env infer`, and a run folder that has to replay."""

import re

from drone_env.cli import main

from .conftest import TOKEN, Infer

LINE = re.compile(
    r"\[START\] task=\S+ env=drone_env_v1 model=scripted"
    r"|\[STEP\] step=\d+ action=(?:UP|DOWN|LEFT|RIGHT|WAIT) reward=\d\.\d\d done=(?:true|false) error=\w+"
    r"|\[END\] success=(?:true|false) steps=\d+ score=0\.\d{3} rewards=(?:\d\.\d\d(?:,\d\.\d\d)*)?"
)


def blocks(out: str) -> list[list[str]]:
    """The lines of each flight; fails where anything else is printed or flights are mixed."""
    flights: list[list[str]] = []
    for line in out.splitlines():
        assert LINE.fullmatch(line), line
        if line.startswith("[START]"):
            assert not flights or flights[-1][-1].startswith("[END]")
            flights.append([])
        flights[-1].append(line)
    for lines in flights:
        assert lines[-1].startswith("[END]")
        assert [int(line.split()[1][5:]) for line in lines[1:-1]] == list(range(1, len(lines) - 1))
    return flights


def verified(done: Infer) -> None:
    """Every flight replays, and nothing holds the token."""
    assert main(["replay", str(done.folder / "episodes.jsonl"), "--verify"]) == 0
    assert not any(TOKEN in path.read_text() for path in done.folder.iterdir())
    assert TOKEN not in done.out + done.err
