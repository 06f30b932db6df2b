"""`drone-env infer`: pilots that do as they are told score what the same moves score elsewhere."""

import asyncio
import os
import subprocess
import sys
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest

from drone_env.core.seeds import SPLITS
from drone_env.llm.answers import Answer
from drone_env.llm.budget import Options
from drone_env.llm.verify import verified_run
from drone_env.planning.optimal import solve
from tests.toy import LOG_OF_MAP_14

from .conftest import ROOT, TOKEN, Start, blocks, environment, verified
from .stored_run import Scripted, fly

ROUTES = int(os.environ.get("DRONE_ENV_LLM_ROUTES", "30"))
"""Number of flights with one call each."""


@pytest.mark.feature("I2")
def test_log_lines_to_the_byte(endpoint: Start) -> None:
    """Of `python inference.py`, with its settings from .env and, before that, from the environment."""
    scripted = endpoint(pilot="greedy")
    (scripted.folder / ".env").write_text(f"OPENAI_API_KEY={TOKEN}\nAPI_BASE_URL={scripted.url}\nDRONE_TASK=hard\n")
    done = subprocess.run(
        [sys.executable, str(ROOT / "inference.py"), "--seeds", "14:15", "--no-report"],
        cwd=scripted.folder,
        env=environment(MODEL_NAME="Qwen/Qwen2.5-72B-Instruct", DRONE_TASK="easy_delivery"),
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == LOG_OF_MAP_14.format("Qwen/Qwen2.5-72B-Instruct").encode()
    assert {r["headers"]["authorization"] for r in scripted.requests()} == {f"Bearer {TOKEN}"}
    assert {r["body"]["model"] for r in scripted.requests()} == {"Qwen/Qwen2.5-72B-Instruct"}
    waiting = endpoint(pilot="WAIT").infer("--seeds", "14:15", DRONE_TASK="easy")
    # What the model says itself is no WAIT in place of something else.
    assert (waiting.status, waiting.turns, waiting.flights[0]["waits"]) == (0, {"ok": 60}, 0)
    assert waiting.out.endswith("[END] success=false steps=60 score=0.010 rewards=" + ",".join(["0.10"] * 60) + "\n")


def test_a_perfect_pilot_scores_the_optimum(endpoint: Start) -> None:
    task = "hard"
    done = endpoint(pilot="plan").infer("--task", task, "--episodes", str(ROUTES), "--prompt", "plan")
    assert done.status == 0, done.err
    assert done.turns == {"ok": ROUTES}
    assert len(done.calls) == ROUTES
    start = SPLITS["test"].start
    assert [f["score"] for f in done.flights] == [solve(task, seed).score for seed in range(start, start + ROUTES)]
    assert len(blocks(done.out)) == ROUTES
    verified(done)


@pytest.mark.parametrize("form", ["json", "tool"])
def test_structured_output_and_tool_calls(endpoint: Start, form: str) -> None:
    done = endpoint(pilot="greedy", message={"reasoning_content": "UP"}).infer("--seeds", "14:15", "--answers", form)
    assert (done.turns, done.flights[0]["score"]) == ({"ok": 3}, 0.99), done.err
    assert {call["answer"]["reasoning"] for call in done.calls} == {"UP"}


def test_many_flights_have_their_requests_under_way_at_once(tmp_path: Path) -> None:
    class Counting(Scripted):
        now = most = 0

        async def send(self, request: Mapping[str, Any], call_id: str) -> Answer:
            self.now += 1
            self.most = max(self.most, self.now)
            for _ in range(99):
                await asyncio.sleep(0)
            self.now -= 1
            return await super().send(request, call_id)

    sender = Counting("greedy")
    flown = fly(sender, tmp_path / "run", Options(concurrency=60), seeds=(0, 100))
    assert (flown.result.verdict, len(flown.result.flights), sender.most) == ("valid", 100, 60)


def test_a_run_keeps_the_rewards_of_a_file_of_ones_own(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy")
    mine = scripted.folder / "mine.toml"
    mine.write_text('id = "mine"\nshaping = 0.25\n[events]\ndelivery = 7\n')
    flown = scripted.infer("--seeds", "14:15", "--reward-profile", "mine.toml")
    assert flown.status == 0, flown.err
    assert flown.out.endswith("rewards=0.25,0.25,7.25\n")
    config = verified_run(flown.folder).config  # where nobody knows the name any more
    assert (config.profile.id, config.profile.shaping) == ("mine", Decimal("0.25"))
    again = ("--seeds", "14:15", "--reward-profile", "mine.toml", "--resume")
    assert scripted.infer(*again, folder=flown.folder).out == flown.out
    mine.write_text('id = "mine"\nshaping = 0.5\n[events]\ndelivery = 7\n')
    other = scripted.infer(*again, folder=flown.folder)
    assert other.status == 2
    assert "another configuration: rewards" in other.err


def test_a_flight_of_bad_answers_waits_to_its_end_and_its_run_is_marked(endpoint: Start) -> None:
    scripted = endpoint(pilot="NORTH")
    done = scripted.infer("--seeds", "14:15", "--report", "--no-moves")
    assert done.status == 0, done.err
    assert done.turns == {"illegal": 60}
    assert len(scripted.requests()) == 120
    assert len({request["port"] for request in scripted.requests()}) == 1, "the connection is used again"
    (flight,) = done.flights
    assert (flight["waits"], flight["score"], flight["success"]) == (60, 0.01, False)
    (lines,) = blocks(done.out)
    assert {(line.split()[2], line.split()[5]) for line in lines[1:-1]} == {("action=WAIT", "error=illegal")}
    verified(done)
    # Beside the score, wherever it is shown.
    told, mark = "100.0% (60 of 60) !", "MARKED: 60 of 60 answers were unusable, more than 5%; the drone waited instead"
    assert f"mean score 0.0100 over 1 flights, 0 delivered everything; unusable answers: {told}\n" in done.err
    assert f"verdict: valid; {mark}\n" in done.err
    for told_once in ("\nno usable answer so far: 10 of 10", "\n60 of 60"):
        common = "unusable answers are illegal, such as 'NORTH': 'NORTH' is not an action\n"
        assert f"\n{done.err}".count(f"{told_once} {common}") == 1
    text = (done.folder / "report.md").read_text()
    assert f"**valid**; {mark}\n" in text
    assert f"| score (95 %) | 0.0100 |\n| unusable answers | {told} |\n" in text
