"""The drone as a task of Inspect, flown through Inspect's own evaluation: `tools/verify.sh adapters`."""

import sys
from pathlib import Path
from typing import Any

import pytest

import drone_env
from drone_env.core.seeds import SPLITS
from drone_env.flights.record import EpisodeRecord, replay
from drone_env.planning.optimal import solve
from drone_env.results.evaluate import episodes_key, run_episodes
from tests.llm.conftest import Endpoint, Start
from tests.tools import ran

pytestmark = pytest.mark.filterwarnings("ignore")


def evaluated(endpoint: Endpoint, folder: Path, arguments: dict[str, Any], **options: Any) -> Any:
    """The log of one evaluation against a scripted endpoint."""
    # Here, since their import warns.
    from inspect_ai import eval as evaluate
    from inspect_ai.model import get_model

    from drone_env.llm.inspect_task import drone_delivery

    model = get_model("openai-api/scripted/pilot", base_url=endpoint.url, api_key="sk-scripted", memoize=False)
    (log,) = evaluate(drone_delivery(**arguments), model=model, log_dir=str(folder / "logs"), display="none", **options)
    return log


def test_a_greedy_pilot_scores_as_the_greedy_agent(endpoint: Start, tmp_path: Path) -> None:
    scripted = endpoint(pilot="greedy")
    log = evaluated(scripted, tmp_path, {"task": "medium", "episodes": 4, "sampling_seed": 5}, epochs=2)
    assert log.status == "success"
    start = SPLITS["test"].start
    greedy = run_episodes(episodes_key("medium", "greedy", range(start, start + 4), "test"))
    flown = [sample.scores["graded"] for sample in log.samples]
    assert sorted(score.value["score"] for score in flown) == sorted([*greedy.scores, *greedy.scores])
    # Each epoch is another draw from the model.
    sent = [request["body"]["seed"] for request in scripted.requests()]
    assert (sent.count(5), sent.count(6), len(sent)) == (*[greedy.steps.sum()] * 2, 2 * greedy.steps.sum())
    by_name = {score.name: score.metrics["mean"].value for score in log.results.scores}
    assert by_name["score"] == pytest.approx(greedy.scores.mean(), abs=1e-12)
    optima = [solve("medium", seed).score for seed in range(start, start + 4)]
    assert by_name["regret"] == pytest.approx(sum(optima) / 4 - greedy.scores.mean(), abs=1e-12)
    assert by_name["success"] == 1
    for score in flown:
        assert score.metadata["turns"]["ok"] == len(score.answer.split())
        replay(EpisodeRecord.model_validate_json(score.metadata["record"]))


def test_bad_answers_are_waits(endpoint: Start, tmp_path: Path) -> None:
    log = evaluated(endpoint(pilot="Let us go up!"), tmp_path, {"episodes": 1})
    (sample,) = log.samples
    assert sample.scores["graded"].metadata["turns"]["parse_error"] == 60
    value = sample.scores["graded"].value
    assert (value["score"], value["unusable"], value["success"]) == (0.01, 1, 0)
    assert "action=WAIT reward=-0.01 done=false error=parse_error" in sample.scores["graded"].explanation


@pytest.mark.parametrize("limit", [{"token_limit": 500}, {"time_limit": 2}])
def test_a_limit_counts_as_waiting_to_the_end(endpoint: Start, tmp_path: Path, limit: dict[str, int]) -> None:
    log = evaluated(endpoint(pilot="greedy", latency=0.3), tmp_path, {"task": "hard", "episodes": 1}, **limit)
    (sample,) = log.samples
    score = sample.scores["graded"]
    assert sample.limit.type == next(iter(limit)).removesuffix("_limit")
    assert score.metadata["status"] == "budget_stop"
    assert 0 < len(score.answer.split()) < 20


def test_a_failing_call_is_an_error_and_no_score(endpoint: Start, tmp_path: Path) -> None:
    scripted = endpoint(pilot="greedy", faults=[[2, 10**9, {"status": 400}]])
    log = evaluated(scripted, tmp_path, {"task": "hard", "episodes": 1})
    assert log.status == "error"
    assert not any(sample.scores for sample in log.samples or [])


def test_an_aborted_answer_is_an_error_and_no_answer_of_the_model(endpoint: Start, tmp_path: Path) -> None:
    log = evaluated(endpoint(pilot="LEFT UP", finish_reason="abort"), tmp_path, {"prompt": "plan", "episodes": 1})
    assert (log.status, "not finished" in str(log.error or log.samples[0].error)) == ("error", True)


def test_the_command_line_knows_the_task(endpoint: Start, tmp_path: Path) -> None:
    scripted = endpoint(pilot="greedy")
    # Inspect finds tasks of packages in a folder of that name alone; what is installed as editable lies elsewhere.
    packages = tmp_path / "site-packages"
    packages.mkdir()
    (packages / "drone_env").symlink_to(Path(drone_env.__file__).parent)
    installed = {"SCRIPTED_API_KEY": "sk-scripted", "SCRIPTED_BASE_URL": scripted.url, "PYTHONPATH": str(packages)}
    command = [sys.executable, "-c", "from inspect_ai._cli.main import main; main()", "eval"]
    arguments = ["drone_env/drone_delivery", "--model", "openai-api/scripted/pilot", "-T", "episodes=2"]
    done = ran(*command, *arguments, "--display", "plain", cwd=tmp_path, **installed)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "easy_delivery (2 samples)" in done.stdout
    assert len(list(tmp_path.glob("logs/*.eval"))) == 1
