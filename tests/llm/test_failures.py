"""Endpoints that refuse, break off or send what is no answer: what is tried again, and what becomes of the flight."""

import json
import shlex
from collections.abc import Callable

import pytest

from .conftest import TOKEN, Endpoint
from .log_lines import blocks, verified

Start = Callable[..., Endpoint]


BROKEN_OFF = (
    'data: {"choices": [{"delta": {"content": "UP"}}]}\n\n'
    'data: {"choices": [{"delta": {}, "finish_reason": "error"}]}\n\ndata: [DONE]\n\n'
)
"""A stream whose first piece looks like an answer."""


class RawJson(str):
    """JSON as it is sent."""

    def __str__(self) -> str:
        return self[:20]


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


@pytest.mark.parametrize(
    ("message", "arguments", "option"),
    [
        (
            "Unsupported parameter: 'max_tokens' is not supported here. Use 'max_completion_tokens' instead.",
            (),
            """--max-answer-tokens 0 --extra '{"max_completion_tokens": 1024}'""",
        ),
        (
            "Unsupported value: 'temperature' does not support 0.0 with this model. Only the default (1) is supported.",
            (),
            "--no-temperature",
        ),
        ("`temperature` and `top_p` cannot both be specified for this model.", ("--top-p", "0.9"), "--no-temperature"),
        ("This model's maximum context length is 512 tokens.", (), "--max-answer-tokens 256"),
        ("Unrecognized request argument supplied: stream_options", ("--stream",), "--no-stream"),
        ("Invalid parameter: 'response_format' of type 'json_schema'.", ("--answers", "json"), "--answers text"),
        ('"auto" tool choice requires --enable-auto-tool-choice', ("--answers", "tool"), "--answers text"),
    ],
)
def test_a_famous_refusal_names_the_option_that_helps(
    endpoint: Start, message: str, arguments: tuple[str, ...], option: str
) -> None:
    scripted = endpoint(pilot="greedy", faults=[[0, 0, {"status": 400, "message": message}]])
    refused = scripted.infer("--seeds", "14:15", *arguments)
    assert refused.status == 2
    named = "another --max-answer-tokens, or with 0 to send none" if "256" in option else option
    assert f"answers 400: {message} (try it with {named})" in refused.err
    # It is an option that there is, and what was refused is not sent again.
    assert scripted.infer("--seeds", "14:15", *arguments, *shlex.split(option)).status == 0
    before, after = (request["body"] for request in scripted.requests()[:2])
    assert any(after.get(name) != value for name, value in before.items())


@pytest.mark.parametrize(
    ("status", "message"),
    [
        (400, "Invalid content type. image_url is only supported by certain models."),
        (422, "messages[1]: unknown variant `image_url`, expected `text`"),
        (400, "messages.1.content must be a string"),
        (404, "No endpoints found that support image input"),
        (500, "image input is not supported - hint: if this is unexpected, you may need to provide the mmproj"),
        (413, "Request Entity Too Large"),
    ],
)
def test_who_takes_no_pictures_is_named_a_prompt_without(endpoint: Start, status: int, message: str) -> None:
    refuses = [[1, 10**9, {"status": status, "message": message}]]
    scripted = endpoint(pilot="WAIT", faults=refuses)
    refused = scripted.infer("--seeds", "14:16", "--prompt", "vision", "--concurrency", "1")
    assert (refused.status, len(scripted.requests())) == (2, 2)
    assert f"answers {status}: {message} (each call shows a picture: try it with one that does not" in refused.err
    # Where none is shown, it is a refusal like any other.
    plain = endpoint(pilot="WAIT", faults=refuses).infer("--seeds", "14:15", "--max-calls", "2", "--tries", "1")
    assert "shows a picture" not in plain.err


@pytest.mark.parametrize(("status", "message"), [(401, "no image for you"), (503, "the image store is not supported")])
def test_other_refusals_are_not_blamed_on_the_picture(endpoint: Start, status: int, message: str) -> None:
    scripted = endpoint(pilot="WAIT", faults=[[0, 10**9, {"status": status, "message": message}]])
    refused = scripted.infer("--seeds", "14:15", "--prompt", "vision", "--tries", "1")
    assert message in refused.err
    assert "try it with" not in refused.err


def test_no_option_is_named_for_what_was_not_sent(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy", faults=[[0, 0, {"status": 400, "message": "no temperature, please"}]])
    done = scripted.infer("--seeds", "14:15", "--no-temperature")
    assert "answers 400: no temperature, please\n" in done.err


def test_a_400_for_a_later_call_costs_its_flight_alone(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy", faults=[[1, 1, {"status": 400}]])
    done = scripted.infer("--seeds", "14:16", "--concurrency", "1")
    assert [f["status"] for f in done.flights] == ["errored", "finished"]
    assert done.flights[0]["error"] == "400: scripted 400"
    assert [len(call["failures"]) for call in done.calls[:3]] == [0, 1, 0]


def test_a_429_is_told_and_tried_again(endpoint: Start) -> None:
    faults = [[1, 1, {"status": 429, "headers": {"Retry-After": "0.1"}}]]
    scripted = endpoint(pilot="greedy", faults=faults)
    done = scripted.infer("--seeds", "14:15")
    assert done.status == 0, done.err
    assert [request["call"] for request in scripted.requests()] == ["0-1-1", "0-2-1", "0-2-1", "0-3-1"]
    told = "map 14, turn 2: attempt 1 of 6 failed: 429: scripted 429; next attempt in 0.1 s (1 retry so far)\n"
    assert told in done.err
    assert done.calls[1]["failures"] == [{"status": 429, "reason": "scripted 429", "waited": 0.1}]
    assert done.turns == {"ok": 3}
    verified(done)


@pytest.mark.parametrize(
    ("fault", "stream"),
    [
        ({"status": 500}, "--stream"),
        ({"status": 503}, "--no-stream"),
        ({"status": 408}, "--no-stream"),
        ({"status": 409}, "--no-stream"),
        ("cut", "--stream"),
        ("cut", "--no-stream"),
        ("cut_body", "--stream"),
        ("cut_body", "--no-stream"),
        ({"sends": ""}, "--no-stream"),
        ({"sends": '{"error": {"code": 503}}'}, "--no-stream"),
        ({"sends": '{"error": "overloaded"}'}, "--no-stream"),
        ({"sends": '{"object": "error", "message": "busy", "code": 500}'}, "--no-stream"),
        ({"sends": '{"choices": []}'}, "--no-stream"),
        ({"sends": '{"choices": [{"message": null, "finish_reason": "stop"}]}'}, "--no-stream"),
        ({"sends": '{"choices": [{"message": {"content": null}, "finish_reason": null}]}'}, "--no-stream"),
        ({"sends": 'data: {"error": {"code": 503}}\n\n'}, "--stream"),
        ({"sends": BROKEN_OFF}, "--stream"),
    ],
)
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


@pytest.mark.parametrize("stream", ["--stream", "--no-stream"])
@pytest.mark.parametrize(("fault", "most"), [("flood", "4,194,304"), ("packed flood", "65,536")])
def test_an_answer_without_end_is_not_read_on(endpoint: Start, fault: str, most: str, stream: str) -> None:
    scripted = endpoint(pilot="greedy", faults=[[0, 0, fault]])
    done = scripted.infer("--seeds", "14:15", stream)
    assert [flight["error"] for flight in done.flights] == [f"200: not an answer: it takes more than {most} bytes"]
    assert len(scripted.requests()) == 1


@pytest.mark.parametrize(
    ("error", "told"),
    [
        ({"message": "quota exceeded", "code": 402}, "402: quota exceeded (in a 200 response)"),
        ({"message": "no temperature", "code": "400"}, "400: no temperature (in a 200 response) (try it with "),
        ({"code": 401}, "401: the token is missing or wrong: "),
    ],
)
def test_an_error_sent_as_200_that_stays_stops_the_run_at_once(endpoint: Start, error: object, told: str) -> None:
    scripted = endpoint(pilot="greedy", faults=[[0, 0, {"sends": json.dumps({"error": error})}]])
    done = scripted.infer("--seeds", "14:15")
    assert (done.status, f"answers {told}" in done.err) == (2, True), done.err
    assert len(scripted.requests()) == 1


def test_a_failure_without_a_reason_is_named_by_its_status(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy", faults=[[0, 0, {"status": 500, "message": ""}]])
    done = scripted.infer("--seeds", "14:15")
    assert "failed: 500: Internal Server Error, without a reason; next attempt in " in done.err


def test_what_an_endpoint_says_cannot_move_the_terminal(endpoint: Start) -> None:
    fault = {"status": 401, "message": "\x1b[2Jgone"}
    done = endpoint(pilot="greedy", faults=[[0, 0, fault]]).infer("--seeds", "14:15")
    assert done.status == 2
    assert "\ufffd[2Jgone" in done.err
    assert "\x1b" not in done.err


def test_of_a_long_reason_the_beginning_is_kept(endpoint: Start) -> None:
    fault = {"status": 500, "message": "y" * 1000}
    done = endpoint(pilot="greedy", faults=[[0, 0, fault]]).infer("--seeds", "14:15")
    assert done.calls[0]["failures"][0]["reason"] == "y" * 300
