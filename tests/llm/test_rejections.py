"""Endpoints that reject a parameter or a role: what later requests send, and what the transcript keeps of it."""

from typing import Any

import pytest

from drone_env.llm.sender import changed, changes_for

from .conftest import ENDPOINTS, Start, verified

SENT: dict[str, Any] = {
    "messages": [{"role": "system", "content": "Fly."}, {"role": "user", "content": "Where?"}],
    "max_tokens": 9,
    "temperature": 0.0,
    "seed": 1,
    "tool_choice": "auto",
    "reasoning_effort": "low",
}
USE_OTHER = "Unsupported parameter: 'max_tokens' is not supported with this model. Use 'max_completion_tokens' instead."
NO_SYSTEM = "System role not supported"
ONE_ONLY = "Unsupported value: 'temperature' does not support 0.0 with this model. Only the default is supported."


@pytest.mark.parametrize(("reason", "changes"), ENDPOINTS["rejections"])
def test_what_a_reason_changes(reason: str, changes: dict[str, str | None]) -> None:
    assert changes_for(reason, SENT) == changes
    # A part that is not sent is not why the request was refused.
    assert changes_for(reason, changed(SENT, {**dict.fromkeys(SENT.keys() - {"messages"}), "system": "merge"})) == {}


def test_a_value_that_the_user_chose_is_not_dropped_for_being_out_of_range() -> None:
    assert changes_for("temperature must be at most 1", {**SENT, "temperature": 1.5}) == {}


def test_a_run_changes_its_requests_and_stays_true(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy", rejects={"max_tokens": USE_OTHER, "temperature": ONE_ONLY, "system": NO_SYSTEM})
    # Three refusals count as calls, but not as tries.
    run = ("--seeds", "14:16", "--concurrency", "1", "--tries", "1")
    first = scripted.infer(*run, "--max-calls", "5")
    assert (first.status, first.turns) == (3, {"ok": 2, "budget_stop": 1}), first.err
    merged = "the system text is sent in the first user message"
    parts = ["max_tokens is sent as max_completion_tokens", "temperature is not sent", merged]
    told = first.err.splitlines()[:3]
    assert [line.partition(":")[0] for line in told] == parts, first.err
    assert told[0].endswith(f": the endpoint returned 400: {USE_OTHER}")
    assert first.err.endswith("--resume and a higher limit\n")
    done = scripted.infer(*run, "--resume", folder=first.folder)
    assert (done.status, "is sent" in done.err) == (0, False), "each change is printed once"
    bodies = [request["body"] for request in scripted.requests()]
    assert sum("max_tokens" in body or "temperature" in body for body in bodies) == 2
    assert {body["max_completion_tokens"] for body in bodies[3:]} == {1024}
    assert {message["role"] for body in bodies[3:] for message in body["messages"]} == {"user"}
    changes = {"max_tokens": "max_completion_tokens", "temperature": None, "system": "merge"}
    assert [call["changes"] for call in done.calls] == [changes] * len(done.calls)
    assert [call["messages"] for call in done.calls] == [body["messages"] for body in bodies[3:]]
    assert [failure["waited"] for failure in done.calls[0]["failures"]] == [0, 0, 0]
    verified(done)
    # A request that was not sent so does not verify.
    path = done.folder / "calls.jsonl"
    path.write_text(path.read_text().replace('"temperature":null', '"seed":null', 1))
    assert "has another request than this run sends" in scripted.infer(*run, "--resume", folder=done.folder).err


def test_requests_on_their_way_are_repeated_after_a_change(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy", together=6, rejects={"max_tokens": USE_OTHER})
    done = scripted.infer("--episodes", "6", "--task", "easy", "--tries", "1")
    assert (done.status, done.err.count("max_tokens is sent as")) == (0, 1), done.err
    assert sum("max_tokens" in request["body"] for request in scripted.requests()) == 6
    verified(done)
