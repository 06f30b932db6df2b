"""A run of a language model on the leaderboard: only where it was checked, is whole and valid."""

from pathlib import Path

from drone_env.errors import DroneEnvError
from drone_env.llm.report import report
from drone_env.llm.run_folder import RESULTS, load_config
from drone_env.llm.verify import verified_run
from drone_env.results.leaderboard import Judged, Refused


def judge(path: Path) -> Judged | Refused:
    """Check a run: its figures, or why it is not ranked."""
    try:
        load_config(path)
        if not (path / RESULTS).exists():
            # Written at the end of each part of a run.
            under_way = "no flights yet: it is under way, or was killed and can be gone on with (--resume)"
            return Refused(path, under_way, damaged=False)
        run = verified_run(path)
    except (DroneEnvError, OSError, ValueError) as error:
        return Refused(path, str(error).removeprefix(f"{path}: "), damaged=True)
    figures = report(run, moves=False)
    if figures["verdict"] != "valid":
        return Refused(path, f"{figures['verdict']}: {figures['reason']}", damaged=False)
    return Judged(path, figures)
