"""`drone-env infer --local`, with a tiny model of a real architecture: `tools/verify.sh adapters`."""

import asyncio
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import torch
from tokenizers import Tokenizer, models, pre_tokenizers
from transformers import (
    AutoModelForCausalLM,
    Gemma3ForCausalLM,
    Gemma3TextConfig,
    PreTrainedTokenizerFast,
    Qwen3Config,
    Qwen3ForCausalLM,
)

from drone_env.cli import main
from drone_env.llm.answers import Answer
from drone_env.llm.local import LocalModel, read_shared
from drone_env.llm.prompt import get_prompt
from drone_env.llm.run_folder import read_run
from drone_env.llm.sender import TryFailedError
from drone_env.llm.text_episode import TextEpisode
from tests.llm.conftest import json_lines

pytestmark = pytest.mark.filterwarnings("ignore")
WORDS = ["<end>", "<unknown>", *"ABCDEFGH", *map(str, range(61)), "parcel", "pad", "spare", "short", "units", "steps"]
TEMPLATE = "{% for message in messages %}{{ message.content }} {% endfor %}"
RUN = ("--task", "rush_easy", "--prompt", "stops", "--seeds", "3:6", "--max-answer-tokens", "2")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A Qwen3 of random weights, and a tokenizer with a word per token."""
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("models") / "tiny"
    inner = Tokenizer(models.WordLevel({word: number for number, word in enumerate(WORDS)}, unk_token="<unknown>"))
    inner.pre_tokenizer = pre_tokenizers.Sequence([pre_tokenizers.Whitespace(), pre_tokenizers.Digits()])
    tokenizer = PreTrainedTokenizerFast(
        tokenizer_object=inner, eos_token="<end>", unk_token="<unknown>", chat_template=TEMPLATE
    )
    sizes = {"hidden_size": 32, "intermediate_size": 64, "head_dim": 8, "num_hidden_layers": 2}
    heads = {"num_attention_heads": 4, "num_key_value_heads": 2}
    config = Qwen3Config(vocab_size=len(WORDS), **sizes, **heads, eos_token_id=0, tie_word_embeddings=False)
    Qwen3ForCausalLM(config).save_pretrained(path)
    tokenizer.save_pretrained(path)
    return path


@pytest.fixture(scope="module")
def sliding(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A Gemma 3 of random weights with the same tokenizer; a layer sees the last tokens only."""
    path = tmp_path_factory.mktemp("models") / "sliding"
    shutil.copytree(folder, path)
    sizes = {"hidden_size": 32, "intermediate_size": 64, "head_dim": 8, "num_attention_heads": 4}
    layers = {"layer_types": ["sliding_attention", "full_attention"], "num_hidden_layers": 2, "sliding_window": 400}
    config = Gemma3TextConfig(vocab_size=len(WORDS), num_key_value_heads=2, **sizes, **layers, eos_token_id=0)
    Gemma3ForCausalLM(config).save_pretrained(path)
    return path


def requests(count: int, **options: Any) -> list[dict[str, Any]]:
    """Requests of different lengths."""
    body = {"model": "tiny", "temperature": 0.0, "max_tokens": 4, **options}
    return [{"messages": TextEpisode("skyline_easy", seed, "stops").messages, **body} for seed in range(count)]


def answered(model: LocalModel, *sent: dict[str, Any]) -> list[Answer]:
    async def send() -> list[Answer]:
        return await asyncio.gather(*(model.send(request, "") for request in sent))

    return asyncio.run(send())


def infer(folder: Path, out: Path, *options: str) -> int:
    return main(["infer", "--local", str(folder), "--out", str(out), *RUN, *options])


def answers(run: Path) -> dict[tuple[int, int, int], Any]:
    calls = [call for call in json_lines(run / "calls.jsonl") if call["answer"]]
    return {(call["flight"], call["turn"], call["attempt"]): call["answer"] for call in calls}


@pytest.mark.parametrize("name", ["folder", "sliding"])
def test_a_batch_answers_as_the_model_does_one_request_at_a_time(name: str, request: pytest.FixtureRequest) -> None:
    folder: Path = request.getfixturevalue(name)
    local, alone = LocalModel(folder, "float32"), AutoModelForCausalLM.from_pretrained(folder, dtype=torch.float32)
    sent = requests(20)  # more than a batch of the processor
    texts = [" ".join(message["content"] for message in request["messages"]) + " " for request in sent]
    tokens = local.tokenizer(texts).input_ids
    assert len({len(one) for one in tokens}) > 1
    assert [read_shared(local.model, tokens, most)[0] > 0 for most in (4, 400)] == [True, name == "folder"]
    for text, answer in zip(texts, answered(local, *sent), strict=True):
        inputs = local.tokenizer(text, return_tensors="pt").input_ids
        (row,) = alone.generate(inputs, max_new_tokens=4, do_sample=False)
        assert answer.text == local.tokenizer.decode(row[inputs.shape[1] :], skip_special_tokens=True)
        assert (answer.prompt_tokens, answer.finish_reason) == (inputs.shape[1], "length")
    # The end of an answer, after which only padding follows.
    first = local.tokenizer(answered(local, sent[0])[0].text.split()[0]).input_ids[0]
    local._ends, local._answered = {first}, {}
    ended = answered(local, *sent)[0]
    assert (ended.finish_reason, ended.completion_tokens) == ("stop", 1)


def test_equal_requests_are_answered_once_unless_they_are_sampled(folder: Path) -> None:
    local, rows = LocalModel(folder, "float32"), list[int]()
    generate = local.model.generate
    local.model.generate = lambda **given: rows.append(len(given["input_ids"])) or generate(**given)
    (one, other) = requests(2)
    first = answered(local, one, one, other)
    assert [*answered(local, other, one), first[0]] == [first[2], *first[:2]]
    assert rows == [2]
    sampled = requests(1, temperature=1.5, seed=3, top_k=50)[0]
    assert len({answer.text for answer in answered(local, *[sampled] * 8)}) > 1
    assert rows == [2, 8]


def test_a_stopped_run_goes_on_as_if_it_had_not_stopped(folder: Path, tmp_path: Path) -> None:
    assert infer(folder, tmp_path / "whole") == 0
    assert infer(folder, tmp_path / "cut", "--max-calls", "20", "--concurrency", "2") == 3
    assert infer(folder, tmp_path / "cut", "--resume", "--concurrency", "3") == 0
    assert answers(tmp_path / "whole") == answers(tmp_path / "cut")
    assert (tmp_path / "whole/episodes.jsonl").read_text() == (tmp_path / "cut/episodes.jsonl").read_text()
    flights = read_run(tmp_path / "whole").flights
    assert {run.prompt.id for run in flights} == {get_prompt("stops").id}
    report = json.loads((tmp_path / "whole" / "report.json").read_text())
    assert (report["decisions"], report["steps"]) == (
        sum(len(run.turns) for run in flights),
        sum(run.episode.steps for run in flights),
    )
    assert report["config"]["model"] == "tiny"


def test_answers_equal_those_of_transformers_serve(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from transformers import LlamaConfig, LlamaForCausalLM
    from transformers.cli.serve import Serve

    monkeypatch.setattr("drone_env.llm.local.best_dtype", lambda: "float32")
    llama = tmp_path / "llama"  # of a Qwen 3, the server splits answers at marks that this tokenizer has not
    shutil.copytree(folder, llama)
    sizes = {"hidden_size": 32, "intermediate_size": 64, "num_hidden_layers": 2, "num_attention_heads": 4}
    LlamaForCausalLM(LlamaConfig(vocab_size=len(WORDS), **sizes, eos_token_id=0)).save_pretrained(llama)
    assert infer(llama, tmp_path / "local") == 0
    serve = Serve(str(llama), host="127.0.0.1", port=0, device="cpu", dtype="float32", non_blocking=True)
    try:
        while not serve.server.started:
            serve._thread.join(0.05)
            assert serve._thread.is_alive()
        port = serve.server.servers[0].sockets[0].getsockname()[1]
        served = ("--base-url", f"http://127.0.0.1:{port}/v1", "--model", str(llama), "--concurrency", "1")
        assert main(["infer", *served, "--out", str(tmp_path / "served"), *RUN]) == 0
    finally:
        serve.kill_server()
    local, served = (
        {key: answer["text"] for key, answer in answers(tmp_path / run).items()} for run in ("local", "served")
    )
    assert local == served
    assert len(set(local.values())) > 2


def test_what_is_no_model_is_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    mute = shutil.copytree(folder, tmp_path / "mute")
    (mute / "chat_template.jinja").unlink()
    for options, told in (
        (("--local", str(tmp_path / "none")), "takes the folder of a model"),
        (("--local", str(tmp_path)), "config.json or one GGUF file, it has 0"),
        (("--local", str(mute)), "has no chat template"),
        (("--local", str(folder), "--base-url", "http://localhost:1/v1"), "without --base-url"),
        (("--local", str(folder), "--answers", "json"), "use --answers text"),
        (("--local", str(folder), "--extra", '{"no_such_option": 1}'), "no_such_option"),
    ):
        assert main(["infer", *options, "--out", str(tmp_path / f"run-{len(told)}"), *RUN]) == 2
        assert told in capsys.readouterr().err
    local = LocalModel(folder, "float32")
    local.tokenizer.chat_template = "{{ raise_exception('System role not supported') }}"
    with pytest.raises(TryFailedError) as failed:
        answered(local, *requests(1))
    assert failed.value.changes == {"system": "merge"}
