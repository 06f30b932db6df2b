"""Which prompt a run asks by: one that lets think, your own, that of an old run."""

import json
from collections.abc import Callable

from drone_env.core.seeds import SPLITS
from drone_env.planning.optimal import solve

from .conftest import Endpoint, verified

Start = Callable[..., Endpoint]
OWN = """
format = 1
plan = false
marks = ["MOVE:"]
system = '{% include "rules-2.j2" %}'
user = '{% include "drone-2.j2" %}'
repair = "{{ reason }}"
"""


def test_a_model_may_think_aloud(endpoint: Start) -> None:
    done = endpoint(pilot="aloud").infer("--task", "medium", "--episodes", "2", "--prompt", "think")
    assert (done.status, set(done.turns)) == (0, {"ok"}), done.err
    start = SPLITS["test"].start
    assert [flight["score"] for flight in done.flights] == [solve("medium", start + i).score for i in range(2)]
    verified(done)


def test_a_prompt_of_ones_own_goes_into_the_run(endpoint: Start) -> None:
    scripted = endpoint(pilot="MOVE: LEFT")
    mine = scripted.folder / "mine.toml"
    mine.write_text(OWN)
    first = scripted.infer("--seeds", "14:15", "--prompt", str(mine), "--max-calls", "2")
    assert (first.turns, first.status) == ({"ok": 2, "budget_stop": 1}, 3), first.err
    config = json.loads((first.folder / "run.json").read_text())
    assert (config["prompt"], config["prompt_text"]) == ("mine", OWN)
    assert scripted.requests()[0]["body"]["messages"][0]["content"].startswith("The grid is 10 x 10:")
    # Another file is another run; without one, it goes on with its own.
    mine.write_text(OWN.replace("{{ reason }}", "Again!"))
    again = ("--seeds", "14:15", "--resume", "--max-calls", "5")
    refused = scripted.infer(*again, "--prompt", str(mine), folder=first.folder)
    assert (refused.status, "prompt_digest: " in refused.err) == (2, True)
    mine.unlink()
    resumed = scripted.infer(*again, folder=first.folder)
    assert resumed.turns == {"ok": 5, "budget_stop": 1}
    verified(resumed)
