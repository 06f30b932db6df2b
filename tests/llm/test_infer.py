"""`drone-env infer` against a scripted endpoint: each way to fail, with exact counts."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable

import pytest

from drone_env.cli import main
from drone_env.core.seeds import SPLITS
from drone_env.evaluation import episodes_key, run_episodes
from drone_env.planning.optimal import solve

from .conftest import ROOT, TOKEN, Endpoint, Infer, environment

Start = Callable[..., Endpoint]


class RawJson(str):
    """JSON as it is sent."""

    def __str__(self) -> str:
        return self[:20]


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
    """Every flight replays, and what was flown is what the model said, or WAIT."""
    assert main(["replay", str(done.folder / "episodes.jsonl"), "--verify"]) == 0
    assert not any(TOKEN in path.read_text() for path in done.folder.iterdir())
    assert TOKEN not in done.out + done.err


def test_log_lines_to_the_byte(endpoint: Start) -> None:
    # Map 14 of easy by hand, as in the tests of `fly`.
    done = endpoint(pilot="greedy").infer("--task", "easy", "--seeds", "14:15")
    assert done.status == 0, done.err
    assert done.out == (
        "[START] task=drone_env.graders:grade_easy env=drone_env_v1 model=scripted\n"
        "[STEP] step=1 action=LEFT reward=0.15 done=false error=null\n"
        "[STEP] step=2 action=UP reward=0.15 done=false error=null\n"
        "[STEP] step=3 action=UP reward=0.99 done=true error=null\n"
        "[END] success=true steps=3 score=0.990 rewards=0.15,0.15,0.99\n"
    )
    assert done.turns == {"ok": 3}
    verified(done)


MAPS = int(os.environ.get("DRONE_ENV_LLM_MAPS", "5"))
"""How many maps are flown where every step is a call."""


@pytest.mark.parametrize("task", ["easy", "medium", "hard"])
def test_a_perfect_pilot_scores_the_optimum_on_100_test_maps(endpoint: Start, task: str) -> None:
    done = endpoint(pilot="plan").infer("--task", task, "--episodes", "100", "--prompt", "plan")
    assert done.status == 0, done.err
    assert done.turns == {"ok": 100}
    assert len(done.calls) == 100
    start = SPLITS["test"].start
    assert [f["score"] for f in done.flights] == [solve(task, seed).score for seed in range(start, start + 100)]
    assert len(blocks(done.out)) == 100
    verified(done)


@pytest.mark.parametrize(("task", "stream"), [("easy", "--stream"), ("medium", "--no-stream"), ("hard", "--no-stream")])
def test_a_perfect_pilot_asked_step_by_step(endpoint: Start, task: str, stream: str) -> None:
    maps = MAPS if MAPS >= 100 else 1
    options = ("--task", task, "--episodes", str(maps), "--prompt", "coordinates", stream)
    done = endpoint(pilot="perfect").infer(*options)
    assert done.status == 0, done.err
    start = SPLITS["test"].start
    optima = [solve(task, seed) for seed in range(start, start + maps)]
    assert [f["score"] for f in done.flights] == [optimum.score for optimum in optima]
    assert done.turns == {"ok": sum(optimum.steps for optimum in optima)}
    verified(done)


@pytest.mark.parametrize("task", ["easy", "medium", "hard"])
def test_a_greedy_pilot_equals_the_greedy_agent(endpoint: Start, task: str) -> None:
    done = endpoint(pilot="greedy").infer("--task", task, "--episodes", str(MAPS))
    assert done.status == 0, done.err
    start = SPLITS["test"].start
    greedy = run_episodes(episodes_key(task, "greedy", range(start, start + MAPS), "test"))
    assert [f["score"] for f in done.flights] == greedy.scores.tolist()
    assert [f["steps"] for f in done.flights] == greedy.steps.tolist()


@pytest.mark.parametrize("status", [401, 403, 404])
def test_a_refusing_endpoint_stops_the_run_at_once(endpoint: Start, status: int) -> None:
    message = f"Incorrect API key provided: {TOKEN}"
    scripted = endpoint(pilot="greedy", faults=[[0, 10**9, {"status": status, "message": message}]])
    done = scripted.infer("--episodes", "40", "--concurrency", "4")
    assert done.status == 2
    assert f"answers {status}" in done.err
    assert len(scripted.requests()) <= 4
    assert [f["status"] for f in done.flights] == ["errored"]
    assert done.turns == {"api_error": 1}
    (lines,) = blocks(done.out)
    assert lines[-1] == "[END] success=false steps=0 score=0.010 rewards="
    verified(done)


def test_a_400_for_the_first_call_stops_the_run(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy", faults=[[0, 10**9, {"status": 400, "message": "no temperature, please"}]])
    done = scripted.infer("--episodes", "9", "--concurrency", "1")
    assert done.status == 2
    assert "answers 400: no temperature, please" in done.err
    assert len(scripted.requests()) == 1


def test_a_429_is_waited_for_as_long_as_it_asks(endpoint: Start) -> None:
    faults = [[1, 1, {"status": 429, "headers": {"Retry-After": "2"}}]]
    scripted = endpoint(pilot="greedy", faults=faults)
    done = scripted.infer("--seeds", "14:15")
    assert done.status == 0, done.err
    times = [request["at"] for request in scripted.requests()]
    assert len(times) == 4
    assert times[2] - times[1] >= 2
    assert "waiting 2.0 s" in done.err
    assert done.calls[1]["failures"] == [{"status": 429, "reason": "scripted 429", "waited": 2.0}]
    assert done.turns == {"ok": 3}
    verified(done)


def test_a_429_that_asks_for_too_long_is_an_api_error(endpoint: Start) -> None:
    faults = [[0, 10**9, {"status": 429, "headers": {"Retry-After": "3600"}}]]
    scripted = endpoint(pilot="greedy", faults=faults)
    done = scripted.infer("--seeds", "14:15", "--longest-wait", "1")
    assert done.status == 1
    assert "INVALID" in done.err
    assert len(scripted.requests()) == 1
    assert done.turns == {"api_error": 1}


@pytest.mark.parametrize(
    "fault", [{"status": 500}, {"status": 503}, {"status": 408}, {"status": 409}, "cut", "cut_body"]
)
@pytest.mark.parametrize("stream", ["--stream", "--no-stream"])
def test_failures_that_pass_are_tried_again(endpoint: Start, fault: object, stream: str) -> None:
    scripted = endpoint(pilot="greedy", faults=[[1, 2, fault]])
    done = scripted.infer("--seeds", "14:15", stream)
    assert done.status == 0, done.err
    assert len(scripted.requests()) == 5
    assert done.turns == {"ok": 3}
    assert [len(call["failures"]) for call in done.calls] == [0, 2, 0]
    assert [f["score"] for f in done.flights] == [0.99]
    verified(done)


@pytest.mark.parametrize("fault", ["cut_stream", "end_stream"])
def test_a_stream_that_ends_early_is_tried_again(endpoint: Start, fault: str) -> None:
    scripted = endpoint(pilot="greedy", faults=[[1, 1, fault]])
    done = scripted.infer("--seeds", "14:15", "--stream")
    assert done.status == 0, done.err
    assert done.turns == {"ok": 3}
    assert [len(call["failures"]) for call in done.calls] == [0, 1, 0]


def test_a_time_out_is_tried_again(endpoint: Start) -> None:
    done = endpoint(pilot="greedy", faults=[[1, 1, "hang"]]).infer("--seeds", "14:15", "--timeout", "2")
    assert done.status == 0, done.err
    assert done.turns == {"ok": 3}
    assert done.calls[1]["failures"][0]["reason"] == "no answer within 2 s"


def test_failures_that_stay_make_flights_errored_and_the_run_invalid(endpoint: Start) -> None:
    # The second flight of three fails in its first call for good.
    faults = [[3, 10**9, {"status": 500}]]
    scripted = endpoint(pilot="greedy", faults=faults)
    done = scripted.infer("--seeds", "14:17", "--concurrency", "1", "--tries", "3")
    assert done.status == 1
    assert [f["status"] for f in done.flights] == ["finished", "errored", "errored"]
    assert done.turns == {"ok": 3, "api_error": 2}
    assert len(scripted.requests()) == 3 + 2 * 3
    assert "mean score 0.9900 over 1 flights" in done.err
    assert "errored and left out: 2" in done.err
    assert "verdict: INVALID: 2 of 3 flights errored" in done.err
    verified(done)
    assert len(blocks(done.out)) == 3


# (Of a stream a page of HTML is an early end, which is tried again.)
@pytest.mark.parametrize(
    ("fault", "stream"), [("no_json", "--no-stream"), ("garbage", "--no-stream"), ("garbage", "--stream")]
)
def test_garbage_is_an_api_error_and_not_tried_again(endpoint: Start, fault: str, stream: str) -> None:
    scripted = endpoint(pilot="greedy", faults=[[1, 1, fault]])
    done = scripted.infer("--seeds", "14:15", stream)
    assert done.status == 1
    assert done.turns == {"ok": 1, "api_error": 1}
    assert len(scripted.requests()) == 2


HUGE = "I would fly to the right. " * 4_000


@pytest.mark.parametrize(
    ("pilot", "outcome", "stream"),
    [
        ("I think that we should go RIGHT, since the target lies there.", "parse_error", "--no-stream"),
        ("", "parse_error", "--stream"),
        (HUGE, "parse_error", "--stream"),
        ("NORTH", "illegal", "--no-stream"),
        ("I'm sorry, but I can't help with flying drones.", "refusal", "--no-stream"),
    ],
)
def test_bad_answers_are_repaired_once_then_wait(endpoint: Start, pilot: str, outcome: str, stream: str) -> None:
    scripted = endpoint(pilot=pilot)
    done = scripted.infer("--seeds", "14:15", stream)
    assert done.status == 0, done.err
    assert done.turns == {outcome: 60}
    assert len(scripted.requests()) == 120
    (flight,) = done.flights
    assert (flight["waits"], flight["score"], flight["success"]) == (60, 0.01, False)
    (lines,) = blocks(done.out)
    assert {(line.split()[2], line.split()[5]) for line in lines[1:-1]} == {("action=WAIT", f"error={outcome}")}
    verified(done)


@pytest.mark.parametrize(
    ("script", "outcome"),
    [
        ({"finish_reason": "length"}, "truncated"),
        ({"finish_reason": "content_filter"}, "refusal"),
        ({"message": {"refusal": "no"}}, "refusal"),
    ],
)
def test_answers_that_the_endpoint_marks(endpoint: Start, script: dict, outcome: str) -> None:
    done = endpoint(pilot="RIGHT", **script).infer("--seeds", "14:15")
    assert done.turns == {outcome: 60}
    assert done.flights[0]["waits"] == 60


def test_an_answer_that_the_repair_mends(endpoint: Start) -> None:
    scripted = endpoint(pilot="Let us go up!", repair="greedy")
    done = scripted.infer("--seeds", "14:15")
    assert done.status == 0, done.err
    assert done.turns == {"repaired": 3}
    assert len(scripted.requests()) == 6
    assert done.flights[0]["score"] == 0.99
    assert done.flights[0]["waits"] == 0
    assert scripted.requests()[1]["body"]["messages"][2] == {"role": "assistant", "content": "Let us go up!"}


@pytest.mark.parametrize(
    "pilot",
    ["right", '```json\n{"action": "right"}\n```'],
)
def test_packaging_is_no_matter(endpoint: Start, pilot: str) -> None:
    done = endpoint(pilot=pilot).infer("--seeds", "14:15")
    assert done.turns == {"ok": 60}
    assert done.flights[0]["waits"] == 0


def test_wait_only_is_what_the_model_said(endpoint: Start) -> None:
    done = endpoint(pilot="WAIT").infer("--seeds", "14:15")
    assert done.status == 0
    assert done.turns == {"ok": 60}
    assert (done.flights[0]["waits"], done.flights[0]["score"]) == (0, 0.01)


def test_reasoning_is_kept_and_not_taken_for_an_answer(endpoint: Start) -> None:
    message = {"reasoning_content": "UP UP UP"}
    for stream in ("--stream", "--no-stream"):
        done = endpoint(pilot="greedy", message=message).infer("--seeds", "14:15", stream)
        assert done.turns == {"ok": 3}
        assert {call["answer"]["reasoning"] for call in done.calls} == {"UP UP UP"}


@pytest.mark.parametrize("form", ["json", "tool"])
@pytest.mark.parametrize("stream", ["--stream", "--no-stream"])
def test_structured_output_and_tool_calls(endpoint: Start, form: str, stream: str) -> None:
    done = endpoint(pilot="greedy").infer("--seeds", "14:15", "--answers", form, stream)
    assert done.turns == {"ok": 3}, done.err
    assert done.flights[0]["score"] == 0.99


def test_the_limit_of_calls_holds_exactly_and_resume_goes_on(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy")
    first = scripted.infer("--seeds", "14:16", "--max-calls", "4", "--concurrency", "1")
    assert first.status == 3
    assert len(scripted.requests()) == 4
    assert [f["status"] for f in first.flights] == ["finished", "budget_stop"]
    assert first.turns == {"ok": 4, "budget_stop": 1}
    verified(first)
    second = scripted.infer("--seeds", "14:16", "--resume", folder=first.folder)
    assert second.status == 0, second.err
    calls = [request["call"] for request in scripted.requests()]
    assert len(calls) == len(set(calls)) == second.turns["ok"]
    assert len(blocks(second.out)) == 2
    verified(second)


def test_limits_of_tokens_and_money(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy")
    tokens = scripted.infer("--seeds", "14:15", "--max-tokens", "150")
    assert (tokens.status, tokens.turns) == (3, {"ok": 2, "budget_stop": 1})
    prices = ("--price-prompt", "10", "--price-completion", "50")
    money = scripted.infer("--seeds", "14:15", "--max-cost", "0.001", *prices)
    assert (money.status, money.turns) == (3, {"ok": 1, "budget_stop": 1})
    unmetered = endpoint(pilot="greedy", no_usage=True).infer("--seeds", "14:15", "--max-tokens", "100000")
    assert (unmetered.status, unmetered.turns) == (3, {"ok": 1, "budget_stop": 1})


def test_resume_refuses_another_configuration_and_a_new_run_an_old_folder(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy")
    first = scripted.infer("--seeds", "14:15")
    before = (first.folder / "calls.jsonl").read_bytes()
    again = scripted.infer("--seeds", "14:15", folder=first.folder)
    assert (again.status, "--resume" in again.err) == (2, True)
    other = scripted.infer("--seeds", "14:15", "--temperature", "1", "--resume", folder=first.folder)
    assert other.status == 2
    assert "another configuration: sampling" in other.err
    assert (first.folder / "calls.jsonl").read_bytes() == before
    same = scripted.infer("--seeds", "14:15", "--resume", folder=first.folder)
    assert (same.status, same.out) == (0, first.out)
    assert len(scripted.requests()) == 3


def test_two_runs_in_one_folder_and_ctrl_c(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy", latency=0.1)
    folder = scripted.folder / "run"
    # One after another they take 40 s, more than it takes a busy machine to start a second run.
    flights = ("--task", "hard", "--episodes", "8", "--concurrency", "1")
    arguments = scripted.arguments(*flights, folder=folder)
    process = subprocess.Popen(
        [sys.executable, str(ROOT / "inference.py"), *arguments[1:]],
        env=environment(OPENAI_API_KEY=TOKEN),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # What a shell starts in the background ignores SIGINT, and so do its children.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    deadline = time.monotonic() + 120
    while len(scripted.requests()) < 9:
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < deadline
        time.sleep(0.05)
    second = scripted.infer(*flights, "--resume", folder=folder)
    assert (second.status, second.out) == (2, "")
    assert "another process is working on the run" in second.err
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (130, ""), err
    assert f"--out {folder} --resume" in err
    assert "Traceback" not in err
    lines = (folder / "calls.jsonl").read_text().splitlines()
    paid = {call["request_digest"]: call for call in map(json.loads, lines)}
    done = scripted.infer("--task", "hard", "--episodes", "8", "--concurrency", "8", "--resume", folder=folder)
    assert done.status == 0, done.err
    kept = {call["request_digest"]: call for call in done.calls}
    assert paid
    assert all(kept[digest] == call for digest, call in paid.items())
    verified(done)


def test_the_cache_answers_equal_requests(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy")
    first = scripted.infer("--seeds", "14:15", "--cache", "cache")
    second = scripted.infer("--seeds", "14:15", "--cache", "cache")
    assert (first.out, first.status) == (second.out, second.status)
    assert len(scripted.requests()) == 3
    assert [call["cached"] for call in second.calls] == [True] * 3
    scripted.infer("--seeds", "14:15", "--cache", "cache", "--temperature", "1")
    assert len(scripted.requests()) == 6


def test_only_what_is_needed_is_sent(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy")
    foreign = {"HF_TOKEN": "hf_secret", "OPENAI_ORG_ID": "org-secret", "OPENAI_CUSTOM_HEADERS": "X-Secret: secret"}
    done = scripted.infer("--seeds", "14:15", "--extra", '{"reasoning_effort": "low"}', "--top-p", "0.5", **foreign)
    assert done.status == 0, done.err
    for request in scripted.requests():
        assert request["headers"]["authorization"] == f"Bearer {TOKEN}"
        assert "secret" not in json.dumps(request)
        assert request["body"]["reasoning_effort"] == "low"
        assert (request["body"]["top_p"], request["body"]["temperature"]) == (0.5, 0.0)
    verified(done)


def test_dot_env_is_read_and_the_environment_beats_it(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy")
    (scripted.folder / ".env").write_text(
        f"OPENAI_API_KEY={TOKEN}\nAPI_BASE_URL={scripted.url}\nMODEL_NAME=from/dotenv\nDRONE_TASK=medium_delivery\n"
    )
    done = subprocess.run(
        [sys.executable, str(ROOT / "inference.py")],
        cwd=scripted.folder,
        env=environment(MODEL_NAME="Qwen/Qwen2.5-72B-Instruct"),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0] == (
        "[START] task=drone_env.graders:grade_medium env=drone_env_v1 model=Qwen/Qwen2.5-72B-Instruct"
    )
    assert {r["headers"]["authorization"] for r in scripted.requests()} == {f"Bearer {TOKEN}"}
    assert {r["body"]["model"] for r in scripted.requests()} == {"Qwen/Qwen2.5-72B-Instruct"}


def test_a_short_token_and_a_quoted_one(endpoint: Start) -> None:
    done = endpoint(pilot="greedy").infer("--seeds", "14:15", OPENAI_API_KEY="x")
    assert (done.status, done.turns) == (0, {"ok": 3})
    quoted = endpoint(pilot=f"Your key is {TOKEN}").infer("--seeds", "14:15")
    assert quoted.turns == {"parse_error": 60}
    assert quoted.calls[0]["answer"]["text"] == "Your key is ***"
    verified(quoted)


@pytest.mark.parametrize("stream", [False, True])
@pytest.mark.parametrize(
    "value",
    [
        *([], "UP", None, {"choices": "UP"}, {"choices": ["UP"]}, {"choices": [None]}, {"choices": {"0": 1}}),
        {"choices": [{"message": "UP", "delta": "UP", "finish_reason": "stop"}]},
        {"choices": [{"message": {"tool_calls": ["UP"]}, "delta": {"tool_calls": ["UP"]}, "finish_reason": "stop"}]},
        RawJson('{"choices": ' + "[" * 100_000 + "]" * 100_000 + "}"),
    ],
    ids=str,
)
def test_what_has_not_the_form_of_an_answer_is_an_api_error(endpoint: Start, value: object, stream: bool) -> None:
    text = value if isinstance(value, RawJson) else json.dumps(value)
    # Not formatted, which would shorten it.
    fault = {"sends": "data: " + text + "\n\n" if stream else text}
    arguments = ("--seeds", "14:16", "--tries", "1", *(["--stream"] if stream else []))
    done = endpoint(pilot="greedy", faults=[[0, 10**9, fault]]).infer(*arguments)
    assert (done.status, done.turns) == (1, {"api_error": 2}), done.err


def test_an_error_sent_as_200_is_told(endpoint: Start) -> None:
    fault = {"sends": json.dumps({"error": {"message": "quota exceeded"}})}
    done = endpoint(pilot="greedy", faults=[[0, 0, fault]]).infer("--seeds", "14:15")
    (failure,) = done.calls[0]["failures"]
    assert failure["reason"] == "not an answer: there are no choices, but {'message': 'quota exceeded'}"


@pytest.mark.parametrize("said", ["x" * 195 + TOKEN, {"choices": [{"message": {"content": ["x" * 93 + TOKEN]}}]}])
def test_not_even_half_of_the_token_is_told(endpoint: Start, said: object) -> None:
    done = endpoint(pilot="greedy", faults=[[0, 0, {"sends": json.dumps(said)}]]).infer("--seeds", "14:15")
    assert "xxx***" in done.calls[0]["failures"][0]["reason"]
    assert "xxxsk" not in done.err + (done.folder / "calls.jsonl").read_text()


def test_what_an_endpoint_says_cannot_move_the_terminal(endpoint: Start) -> None:
    fault = {"status": 401, "message": "\x1b[2Jgone"}
    done = endpoint(pilot="greedy", faults=[[0, 0, fault]]).infer("--seeds", "14:15")
    assert done.status == 2
    assert "\ufffd[2Jgone" in done.err
    assert "\x1b" not in done.err


@pytest.mark.parametrize("stream", [False, True])
def test_two_tool_calls_are_no_action(endpoint: Start, stream: bool) -> None:
    calls = [
        {
            "index": i,
            "id": str(i),
            "type": "function",
            "function": {"name": "fly", "arguments": f'{{"direction":"{to}"}}'},
        }
        for i, to in enumerate(("UP", "RIGHT"))
    ]
    message = {"content": "", "tool_calls": calls}
    done = endpoint(pilot="", message=message).infer("--seeds", "14:15", *(["--stream"] if stream else []))
    assert done.turns == {"parse_error": 60}


def test_tokens_beyond_counting_are_not_counted(endpoint: Start) -> None:
    usage = {"prompt_tokens": 10**400, "completion_tokens": -1}
    prices = ("--price-prompt", "1", "--price-completion", "1")
    done = endpoint(pilot="greedy", usage=usage).infer("--seeds", "14:15", *prices)
    assert done.status == 0, done.err
    assert done.calls[0]["answer"]["prompt_tokens"] is None


def test_no_wait_is_longer_than_the_time_of_the_run(endpoint: Start) -> None:
    fault = {"status": 429, "headers": {"Retry-After": "100"}}
    started = time.monotonic()
    done = endpoint(pilot="greedy", faults=[[0, 10**9, fault]]).infer("--seeds", "14:17", "--max-seconds", "0.5")
    assert (done.status, time.monotonic() - started < 50) == (3, True)


def test_the_token_for_this_machine_passes_no_proxy(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy")
    proxies = dict.fromkeys(("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"), "http://127.0.0.1:9")
    done = scripted.infer("--seeds", "14:15", "--tries", "1", **proxies)
    assert done.status == 0, done.err


def test_many_flights_at_once(endpoint: Start) -> None:
    # Step by step where a latency is named; else one call a flight, and so long a latency that a busy machine's own
    # time does not decide.
    named = os.environ.get("DRONE_ENV_LATENCY")
    latency, prompt = (1.0, "plan") if named is None else (float(named), "minimal")
    scripted = endpoint(pilot="plan" if named is None else "greedy", latency=latency)
    began = time.monotonic()
    done = scripted.infer("--episodes", "200", "--concurrency", "200", "--prompt", prompt)
    took = time.monotonic() - began
    assert done.status == 0, done.err
    one_after_another = latency * len(scripted.requests())
    assert took * 20 <= one_after_another, (took, one_after_another)
    assert len(blocks(done.out)) == 200
