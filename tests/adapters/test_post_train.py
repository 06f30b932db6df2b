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


@pytest.fixture(scope="module", params=["short", "stops"])
def data(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp(request.param) / "chat"
    task, seeds = get_task("skyline_easy"), split_seeds("train", 12)
    build_dataset(DatasetConfig(task, seeds, "train", ["optimal"], 0.1, prompt=request.param), folder)
    return folder


def test_the_stages_train(post_train: Any, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options = post_train.Options(data=data, out=tmp_path, quick=True, samplers=("difficulty",))
    post_train.main((), options)
    monkeypatch.setattr(post_train, "paid_for", lambda policy, kind, flight, answers: [1.0] * len(answers))
    post_train.main(("grpo",), post_train.replace(options, rewards=("rank",), seed=1))
    with pytest.raises(SystemExit, match="other options"):
        post_train.main(("grpo",), post_train.replace(options, grpo_lr=0.5))
    results = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    assert results["sft"]["answers"] == 32
    for name in (*(f"grpo-{kind}-difficulty-0" for kind in options.rewards), "grpo-rank-difficulty-1"):
        assert (tmp_path / name / "model.safetensors").exists()
        (row,) = results[name]["log"]
        assert (row["step"], row["groups"], row["answers"]) == (2, 4, 8)
        assert row["answers"] <= row["tokens"] <= 8 * row["answers"]
    assert (row["without_signal"], row["reward"]) == (4, 8)


def test_samples_have_the_likelihoods_that_the_model_gives_each_alone(post_train: Any, data: Path) -> None:
    import torch

    options = post_train.Options(data=data, answer_tokens=3)
    model, tokenizer = post_train.tiny_model(options)
    requests = [post_train.request_of(tokenizer, row["messages"][:-1]) for row in post_train.rows(options)[:5]]
    assert len(set(map(len, requests))) > 1
    policy = post_train.Policy(options, model, tokenizer)
    policy.ends |= set(range(20, 100))  # some samples end early
    answers, likely = policy.sample(requests, 6)
    assert {len(answer) for answer in answers} == {1, 2, 3}
    for number, answer in enumerate(answers):
        request = requests[number // 7]
        logits = model(torch.tensor([[*request, *answer]])).logits[0].log_softmax(-1)[len(request) - 1 : -1]
        assert likely[number].item() == pytest.approx(logits[range(len(answer)), answer].sum().item(), abs=1e-4)
        if number % 7 == 0:
            assert answer == logits.argmax(-1).tolist()


def test_an_answer_follows_the_generation_prompt_and_ends_as_in_the_template(post_train: Any, data: Path) -> None:
    options = post_train.Options(data=data)
    _, tokenizer = post_train.tiny_model(options)
    row = next(row for row in post_train.rows(options) if row["messages"][-1]["content"] in row["options"])
    for template, end in (
        (
            "{{ messages[0].content }}{% if messages[1] %} <unknown> {{ messages[-1].content }} <pad>{% endif %}",
            "<pad>",
        ),
        ("{% for message in messages %}{{ message.content }} {% endfor %}", "<end>"),
    ):
        tokenizer.chat_template = template
        request, answers = post_train.example_of(options, tokenizer, row)
        assert request == post_train.request_of(tokenizer, row["messages"][:-1])
        assert tokenizer.convert_tokens_to_ids([row["messages"][-1]["content"], end]) in map(list, answers)
    tokenizer.chat_template = "{{ messages[0].content }}"
    with pytest.raises(SystemExit, match="does not contain the answers"):
        post_train.end_tokens(tokenizer)


def test_maps_of_a_difficulty_without_signal_are_drawn_less_often(post_train: Any, data: Path) -> None:
    for sampler, drawn in (("difficulty", {0}), ("uniform", {0, 1})):
        maps = post_train.Maps(post_train.Options(data=data), sampler, 0)
        maps.maps, maps.signal = [{"seed": 0, "difficulty": 0}, {"seed": 1, "difficulty": 1}], {0: 1.0, 1: 0.0}
        assert {maps.start()[1] for _ in range(20)} == drawn


def test_a_killed_training_goes_on_bit_for_bit(
    post_train: Any, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = {"layers": 2} if "short" in data.parent.name else {"layers": 1, "lora": 4}
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


def test_wrong_options_are_refused_before_anything_is_written(post_train: Any, data: Path, tmp_path: Path) -> None:
    out, options = tmp_path / "out", post_train.Options(data=data, out=tmp_path / "out", quick=True)
    mute = tmp_path / "mute"
    post_train.tiny_model(options)[1].save_pretrained(mute)
    post_train.tiny_model(options)[0].save_pretrained(mute)
    (mute / "chat_template.jinja").unlink()
    for wrong, told in (
        ({"data": tmp_path}, "contains no data"),
        ({"prompt": "grid"}, "another one than grid"),
        ({"prompt": "none.toml"}, "none.toml"),
        ({"layers": 5}, "--layers must be 1 to 4, not 5"),
        ({"layers": 0}, "--layers must be 1 to 4, not 0"),
        ({"model": str(tmp_path)}, "is not a model that transformers reads"),
        ({"model": str(mute)}, "has no chat template"),
    ):
        with pytest.raises(SystemExit, match=told):
            post_train.main(("sft",), post_train.replace(options, **wrong))
        assert not out.exists()
    with pytest.raises(SystemExit, match="is not a model"):
        post_train.main(("grpo",), options)
    assert not out.exists()


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
def test_grpo_pays_equal_answers_equally_and_unusable_ones_less_than_the_worst(
    post_train: Any, data: Path, kind: Any
) -> None:
    options = post_train.Options(data=data)
    flight = post_train.TextEpisode("skyline_easy", 0, options.task_and_prompt[1])
    row = post_train.rows(options)[0]
    regrets = dict(zip(row["options"], row["regrets"][0], strict=True))
    names = [*sorted(regrets, key=regrets.__getitem__), "nowhere"]
    policy = SimpleNamespace(fly=lambda flights: [twin.episode.waited_out() for twin in flights])
    paid = post_train.paid_for(policy, kind, flight, [post_train.Answer(text=name) for name in names])
    assert paid[-1] == min(paid[:-1]) - 0.01
    if kind == "rank":
        assert paid[0] == 1
        assert paid[:-1] == sorted(paid[:-1], reverse=True)
    elif kind == "regret":
        assert paid[:-1] == pytest.approx([-regrets[name] for name in names[:-1]], abs=1e-9)
    else:
        assert 0.01 <= min(paid[:-1]) <= max(paid) <= 0.99
    assert not flight.turns


def test_the_cells_of_its_notebook_run_without_a_gpu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "examples")
    monkeypatch.setenv("MAPS", "")  # a cell sets it
    notebook = json.loads((ROOT / "examples" / "post_train.ipynb").read_text(encoding="utf-8"))
    *_, outputs = run(notebook, tmp_path)
    shown = "".join(line for output in outputs for line in output["text"])
    assert all(name in shown for name in ("before", "sft", "grpo-rank-uniform-0"))
