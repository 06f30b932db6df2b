"""`examples/post_train.py` and its notebook, at their smallest sizes: `tools/verify.sh adapters`."""

import json
import math
import random
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task
from drone_env.datasets.build import build_dataset
from drone_env.datasets.trajectories import DatasetConfig
from tests.docs.pages import ROOT
from tools.docs_notebook import run

pytestmark = pytest.mark.timeout(900)
sys.path.insert(0, str(ROOT / "examples"))


@pytest.fixture(scope="module")
def post_train() -> Any:
    import post_train

    return post_train


@pytest.fixture(scope="module", params=["compass", "stops"])
def data(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp(request.param) / "chat"
    task, seeds = get_task("skyline_easy"), split_seeds("train", 12)
    build_dataset(DatasetConfig(task, seeds, "train", ["optimal"], 0.1, prompt=request.param), folder)
    return folder


def test_the_stages_train_by_both_trainers_and_evaluate(post_train: Any, data: Path, tmp_path: Path) -> None:
    post_train.main((), post_train.Options(data=data, out=tmp_path, quick=True))
    results = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    models = {"sft", "grpo-score-0", "grpo-regret-0", "grpo-rank-0"}
    assert results["evaluation"].keys() == models | {"optimum"}
    assert all((tmp_path / name / "model.safetensors").exists() for name in models)
    assert results["sft"]["answers"] == 32
    for row in results["evaluation"].values():
        assert 0.01 <= row["score"][0] <= results["evaluation"]["optimum"]["score"][0]
    assert {"usable", "turns"} <= results["evaluation"]["sft"].keys()


def test_a_killed_training_goes_on_bit_for_bit(
    post_train: Any, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = {"layers": 2} if "compass" in data.parent.name else {"layers": 1, "lora": 4}
    options = post_train.Options(data=data, out=tmp_path, answers=24, batch=4, epochs=2, **part)
    post_train.fine_tune(options)
    clock, answered = iter(range(0, 1 << 20, 10)), iter(range(8))
    monkeypatch.setattr(post_train.time, "monotonic", lambda: next(clock))  # a checkpoint after each step
    loss_of = post_train.loss_of

    def killed(*args: Any) -> Any:
        if next(answered, None) is None:
            raise KeyboardInterrupt
        return loss_of(*args)

    other = post_train.replace(options, name="killed")
    monkeypatch.setattr(post_train, "loss_of", killed)
    with pytest.raises(KeyboardInterrupt):
        post_train.fine_tune(other)
    assert (tmp_path / "killed" / "checkpoint.pt").exists()
    monkeypatch.setattr(post_train, "loss_of", loss_of)
    with pytest.raises(SystemExit, match="other options"):
        post_train.fine_tune(post_train.replace(other, batch=8))
    post_train.fine_tune(other)
    assert not (tmp_path / "killed" / "checkpoint.pt").exists()
    one, two = ((tmp_path / name / "model.safetensors").read_bytes() for name in ("sft", "killed"))
    assert one == two


def test_the_loss_is_the_divergence_from_all_answers_to_learn(post_train: Any) -> None:
    """The model says 3, 4 or 5 with equal probability; the answers begin with 3 (twice) and 4."""
    import torch

    logits = torch.full((8,), -1e9)
    logits[[3, 4, 5]] = 0.0
    layers = lambda **_: SimpleNamespace(last_hidden_state=torch.zeros(1, 4, 2))  # noqa: E731
    head = lambda hidden: logits.expand(len(hidden), 8)  # noqa: E731
    model = SimpleNamespace(get_decoder=lambda: layers, get_output_embeddings=lambda: head)
    answers = {(3, 5): 0.25, (3, 4): 0.25, (4, 5): 0.5}
    first = math.log(3) - math.log(2)  # from 1/2, 1/2 to 1/3, 1/3, 1/3
    second = {3: math.log(3) - math.log(2), 4: math.log(3)}
    losses = {round(float(post_train.loss_of(model, [([1, 2], answers)], random.Random(n))), 5) for n in range(20)}
    assert losses == {round(first + loss, 5) for loss in second.values()}


def test_words_that_all_requests_share_are_read_once_and_change_no_loss(post_train: Any, data: Path) -> None:
    options = post_train.Options(data=data)
    model, tokenizer = post_train.tiny_model(options)
    first, *others = [post_train.example_of(options, tokenizer, row) for row in post_train.rows(options)[:3]]
    batch = [([*first[0][:9], *request], answers) for request, answers in (first, *others)]
    assert post_train.read_shared(model, [request for request, _ in batch])[0] >= 9
    together = post_train.loss_of(model, batch, random.Random(0))
    rng = random.Random(0)
    alone = [post_train.loss_of(model, [example], rng) for example in batch]
    assert together.item() == pytest.approx(sum(alone).item() / 3, abs=1e-5)


@pytest.mark.parametrize("kind", ["rank", "regret", "score"])
def test_grpo_pays_equal_answers_equally_and_unusable_ones_like_the_worst(
    post_train: Any, data: Path, kind: Any
) -> None:
    options = post_train.Options(data=data)
    (flight,) = options.flights("train", 1)
    row = post_train.rows(options)[0]
    regrets = dict(zip(row["options"], row["regrets"][0], strict=True))
    names = [*sorted(regrets, key=regrets.__getitem__), "nowhere"]
    pilot = SimpleNamespace(
        read=lambda name: post_train.Answer(text=name),
        fly=lambda flights: [twin.episode.waited_out() for twin in flights],
    )
    visits = post_train.Visits(options, kind, 0, pilot)
    pays = post_train.pays_of(flight, kind)
    count = len(names)
    paid = visits.reward(names, [flight] * count, [pays] * count, lambda *_: None)
    assert paid[-1] == min(paid[:-1])
    if kind == "rank":
        assert paid[0] == 1
        assert paid == [*sorted(paid[:-1], reverse=True), 0]
    elif kind == "regret":
        assert paid[:-1] == pytest.approx([-regrets[name] for name in names[:-1]], abs=1e-9)
    else:
        assert 0.01 <= min(paid) <= max(paid) <= 0.99
    assert flight.messages == options.flights("train", 1)[0].messages


def test_the_cells_of_its_notebook_run_without_a_gpu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "examples")
    notebook = json.loads((ROOT / "examples" / "post_train.ipynb").read_text(encoding="utf-8"))
    *_, outputs = run(notebook, tmp_path)
    assert {"optimum", "before", "sft", "grpo-rank-0"} <= set("".join(outputs[0]["text"]).split())
