"""`drone-env infer`: what it sends, prints, stores and scores."""

import json
import os
import subprocess
import sys

import pytest

from drone_env.core.seeds import SPLITS
from drone_env.planning.optimal import solve
from tests.toy import LOG_OF_MAP_14

from .conftest import ROOT, TOKEN, Start, blocks, environment, verified

ROUTES = int(os.environ.get("DRONE_ENV_LLM_ROUTES", "5"))
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
    assert (waiting.status, waiting.turns, waiting.flights[0].waits) == (0, {"ok": 60}, 0)
    assert waiting.out.endswith("[END] success=false steps=60 score=0.010 rewards=" + ",".join(["0.10"] * 60) + "\n")


def test_a_perfect_pilot_scores_the_optimum(endpoint: Start) -> None:
    done = endpoint(pilot="plan").infer("--task", "hard", "--episodes", str(ROUTES), "--prompt", "plan")
    assert (done.status, done.turns, len(done.calls)) == (0, {"ok": ROUTES}, ROUTES), done.err
    seeds = range(SPLITS["test"].start, SPLITS["test"].start + ROUTES)
    assert [flight.score for flight in done.flights] == [solve("hard", seed).score for seed in seeds]
    assert len(blocks(done.out)) == ROUTES
    verified(done)


@pytest.mark.parametrize("form", ["json", "tool"])
def test_structured_output_and_tool_calls(endpoint: Start, form: str) -> None:
    done = endpoint(pilot="greedy", message={"reasoning_content": "UP"}).infer("--seeds", "14:15", "--answers", form)
    assert (done.turns, done.flights[0].score) == ({"ok": 3}, 0.99), done.err
    assert {call["answer"]["reasoning"] for call in done.calls} == {"UP"}


def test_flights_of_bad_answers_wait_and_their_run_is_marked(endpoint: Start) -> None:
    # Ten flights with one plan each, which is asked for twice.
    run = ("--seeds", "14:24", "--prompt", "plan", "--concurrency", "1", "--report")
    scripted = endpoint(pilot="NORTH")
    done = scripted.infer(*run)
    assert (done.status, done.turns, len(scripted.requests())) == (0, {"illegal": 10}, 20), done.err
    assert len({request["port"] for request in scripted.requests()}) == 1, "the connection is used again"
    assert {(flight.waits, flight.score, flight.success) for flight in done.flights} == {(1, 0.01, False)}
    for _, step, _ in blocks(done.out):
        assert (step.split()[2], step.split()[5]) == ("action=WAIT", "error=illegal")
    verified(done)
    # Beside the score, wherever it is shown.
    told, mark = "100.0% (10 of 10) !", "MARKED: 10 of 10 answers were unusable, more than 5%; the drone waited instead"
    flights = "10 flights, 0 delivered everything by 10 decisions in 10 steps"
    assert f"mean score 0.0100 over {flights}; unusable answers: {told}\n" in done.err
    assert f"verdict: valid; {mark}\n" in done.err
    common = "10 of 10 unusable answers are illegal, such as 'NORTH': 'NORTH' is not an action\n"
    assert done.err.count(common) == 1
    assert json.loads((done.folder / "report.json").read_text())["unusable"]["marked"]


def test_only_what_is_needed_is_sent(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy")
    foreign = {"HF_TOKEN": "hf_secret", "OPENAI_ORG_ID": "org-secret", "OPENAI_CUSTOM_HEADERS": "X-Secret: secret"}
    named = ("--max-completion-tokens", "99", "--reasoning-effort", "low", "--extra", '{"top_p": 0.5}')
    done = scripted.infer("--seeds", "14:15", *named, **foreign)
    assert done.status == 0, done.err
    for request in scripted.requests():
        assert request["headers"]["authorization"] == f"Bearer {TOKEN}"
        assert "secret" not in json.dumps(request)
        fields = {"max_completion_tokens": 99, "reasoning_effort": "low", "top_p": 0.5, "temperature": 0.0}
        assert request["body"].items() >= fields.items()
        assert "max_tokens" not in request["body"]


def test_a_quoted_token_reaches_no_file_no_request_and_no_terminal(endpoint: Start) -> None:
    faults = [[2, 2, {"status": 400, "message": f"bad key {TOKEN}"}]]
    done = endpoint(pilot=f"Your key is {TOKEN}", faults=faults).infer("--seeds", "14:15", "--max-calls", "3")
    assert [call["answer"] and call["answer"]["text"] for call in done.calls] == ["Your key is ***"] * 2 + [None]
    # The second request quotes the first answer as the transcript has it.
    assert done.calls[1]["messages"][2]["content"] == "Your key is ***"
    assert "400: bad key ***" in done.err
    verified(done)
