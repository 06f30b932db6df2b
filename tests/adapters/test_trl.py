"""The drone in TRL's own GRPOTrainer: `tools/verify.sh adapters`, as TRL is no part of the development tools."""

import json
from pathlib import Path
from typing import Any

import pytest

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.rewards import DEFAULT_PROFILE, get_reward_profile, profile_for_discount
from drone_env.core.tasks import get_task
from drone_env.datasets.build import build_dataset
from drone_env.datasets.trajectories import DatasetConfig
from drone_env.llm.trl_environment import DroneEnvironment, flight_reward, training_maps
from drone_env.planning.optimal import solve

CALL = '<tool_call>\n{{"name": "fly", "arguments": {{"direction": "{}"}}}}\n</tool_call>'
ROUTE = '<tool_call>\n{{"name": "fly_route", "arguments": {{"directions": {}}}}}\n</tool_call>'


def tokenizer() -> Any:
    """One token a byte, with the chat template of Qwen 3, and nothing from a hub."""
    import trl
    from tokenizers import Tokenizer, decoders, models, pre_tokenizers
    from transformers import PreTrainedTokenizerFast

    bytes_ = sorted(pre_tokenizers.ByteLevel.alphabet())
    inner = Tokenizer(models.BPE(vocab={letter: i for i, letter in enumerate(bytes_)}, merges=[]))
    inner.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    inner.decoder = decoders.ByteLevel()
    made = PreTrainedTokenizerFast(tokenizer_object=inner, eos_token="<|im_end|>", pad_token="<|endoftext|>")
    made.add_special_tokens({"additional_special_tokens": ["<|im_start|>"]})
    made.chat_template = (Path(trl.__file__).parent / "chat_templates" / "qwen3.jinja").read_text(encoding="utf-8")
    return made


def tiny_model(words: Any) -> Any:
    from transformers import Qwen2Config, Qwen2ForCausalLM

    config = Qwen2Config(
        vocab_size=len(words),
        hidden_size=16,
        intermediate_size=32,
        num_hidden_layers=1,
        num_attention_heads=2,
        num_key_value_heads=2,
        max_position_embeddings=8192,
    )
    return Qwen2ForCausalLM(config)


TRAINING = {"max_steps": 1, "learning_rate": 1.0, "logging_steps": 1, "report_to": [], "use_cpu": True, "bf16": False}


def scripted(said: list[list[Any]], folder: Path, data: Any, reward: Any, environment: Any) -> tuple[Any, list[str]]:
    """A trainer whose model answers by one script for each rollout of its group, and the list of what it is asked.

    All else, from the tool's schema to the step of the optimiser, is TRL's.
    """
    # Here, since their import warns.
    from trl import GRPOConfig, GRPOTrainer

    words, asked = tokenizer(), list[str]()

    class Scripted(GRPOTrainer):
        def _generate_single_turn(self, prompt_ids: list[list[int]], *_: Any, **__: Any) -> Any:
            asked.extend(words.decode(ids) for ids in prompt_ids)
            answers = [script.pop(0) for script in said if script]
            assert len(answers) == len(prompt_ids)
            texts = [answer() if callable(answer) else answer for answer in answers]
            return [words.encode(f"{text}<|im_end|>", add_special_tokens=False) for text in texts], None

    sizes = {"per_device_train_batch_size": len(said), "num_generations": len(said), "max_completion_length": 2000}
    trainer = Scripted(
        model=tiny_model(words),
        processing_class=words,
        train_dataset=data,
        environment_factory=environment,
        reward_funcs=reward,
        args=GRPOConfig(output_dir=str(folder), **sizes, **TRAINING),
    )
    return trainer, asked


def trained(trainer: Any) -> dict[str, float]:
    """The trainer's log of its one step."""
    trainer.train()
    (log,) = [entry for entry in trainer.state.log_history if "reward" in entry]
    return log


def paid(route: list[str]) -> float:
    """What flying a route over map 14, and waiting to the end, pays undiscounted."""
    episode = Episode("easy", profile_for_discount(get_reward_profile(DEFAULT_PROFILE), 1), seed=14)
    pay = [episode.step(Action[direction]) for direction in route]
    while not episode.ended:
        pay.append(episode.step(Action.WAIT))
    return sum(pay)


@pytest.mark.timeout(600)
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("plan", [None, "plan"])
def test_the_trainer_flies_scores_and_learns(plan: str | None, tmp_path: Path) -> None:
    best = [action.name for action in solve("easy", 14).actions]
    # What the model says in the four rollouts of its group, turn by turn; a finished one says no more.
    if plan:
        said = [[json.dumps({"actions": best})], [best[0]], ["NORTH"], ["Done."]]
    else:
        routes = [[CALL.format(direction) for direction in route] for route in (best[:1], ["NORTH", *best], [])]
        said = [[*route, "Done."] for route in [[ROUTE.format(json.dumps(best))], *routes]]
    calls = sum(map(len, said)) - len(said)
    data = training_maps("easy", 1, plan=plan).map(lambda row: {**row, "seed": 14})
    trainer, asked = scripted(said, tmp_path, data, flight_reward, None if plan else DroneEnvironment)
    before = [p.detach().clone() for p in trainer.model.parameters()]
    log = trained(trainer)
    # By tool calls the wrong word costs no step; as an answer it is unusable.
    wrong = [] if plan else best
    pay = [paid(route) for route in (best, best[:1], wrong, [])]
    owner = "flight_reward" if plan else "DroneEnvironment"
    assert log[f"rewards/{owner}/mean"] == log["reward"] == pytest.approx(sum(pay) / 4)
    means = [(1 if plan else 2) / 4, (len(best) + 1 + len(wrong)) / 4, 0.5 if plan else 0]
    assert [log[f"flight/{name}"] for name in ("success", "steps", "unusable")] == means
    assert log["flight/score"] + log["flight/regret"] == pytest.approx(solve("easy", 14).score)
    assert any(bool((p != q).any()) for p, q in zip(before, trainer.model.parameters(), strict=True))
    if plan:
        return
    assert log["tools/failure_frequency"] == pytest.approx(1 / calls)
    assert all('"name": "fly_route"' in text and '"enum": ["UP"' in text for text in asked)
    assert any("Mission accomplished" in text for text in asked)
    assert any("'NORTH' is not an action" in text for text in asked)


@pytest.mark.timeout(600)
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("prompt", ["plan", "minimal"])
def test_the_trainer_learns_from_the_dataset(prompt: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_HOME", str(tmp_path / "hub"))
    from datasets import load_dataset
    from trl import SFTConfig, SFTTrainer

    build_dataset(DatasetConfig(get_task("easy"), range(2), "train", ["optimal"], prompt=prompt), tmp_path / "set")
    chat = load_dataset("json", data_files=str(tmp_path / "set" / "chat.jsonl"), split="train")
    words = tokenizer()
    args = SFTConfig(output_dir=str(tmp_path), max_length=8192, **TRAINING)
    sft = SFTTrainer(tiny_model(words), args, processing_class=words, train_dataset=chat)
    sft.train()
    assert sft.state.log_history[0]["loss"] > 0
    text = words.decode(sft.train_dataset[0]["input_ids"])
    assert text.rstrip().endswith(f"{chat[0]['messages'][-1]['content']}<|im_end|>")
