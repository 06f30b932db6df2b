"""The drone in TRL's own GRPOTrainer: `tools/verify.sh adapters`, as TRL is no part of the development tools."""

from pathlib import Path
from typing import Any

import pytest

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.rewards import DEFAULT_PROFILE, get_reward_profile, profile_for_discount
from drone_env.llm.trl_environment import DroneEnvironment, training_maps
from drone_env.planning.optimal import solve

CALL = '<tool_call>\n{{"name": "fly", "arguments": {{"direction": "{}"}}}}\n</tool_call>'


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


def paid(route: list[str]) -> float:
    """What flying a route over map 14, and waiting to the end, pays undiscounted."""
    episode = Episode("easy", profile_for_discount(get_reward_profile(DEFAULT_PROFILE), 1), seed=14)
    pay = [episode.step(Action[direction]) for direction in route]
    while not episode.ended:
        pay.append(episode.step(Action.WAIT))
    return sum(pay)


@pytest.mark.timeout(600)
@pytest.mark.filterwarnings("ignore")
def test_the_trainer_flies_scores_and_learns(tmp_path: Path) -> None:
    # Here, since their import warns.
    from transformers import Qwen2Config, Qwen2ForCausalLM
    from trl import GRPOConfig, GRPOTrainer

    words = tokenizer()
    config = Qwen2Config(
        vocab_size=len(words),
        hidden_size=16,
        intermediate_size=32,
        num_hidden_layers=1,
        num_attention_heads=2,
        num_key_value_heads=2,
        max_position_embeddings=8192,
    )
    best = [action.name for action in solve("easy", 14).actions]
    # What the model says in the four rollouts of its group, turn by turn; a finished one says no more.
    routes = [best, best[:1], ["NORTH", *best], []]
    said: list[list[str]] = [[CALL.format(direction) for direction in route] + ["Done."] for route in routes]

    class Scripted(GRPOTrainer):
        """Answers by script; all else, from the tool's schema to the step of the optimiser, is TRL's."""

        def _generate_single_turn(self, prompt_ids: list[list[int]], *_: Any, **__: Any) -> Any:
            texts = [words.decode(ids) for ids in prompt_ids]
            asked.extend(texts)
            answers = [script.pop(0) for script in said if script]
            assert len(answers) == len(prompt_ids)
            return [words.encode(f"{answer}<|im_end|>", add_special_tokens=False) for answer in answers], None

    asked: list[str] = []
    data = training_maps("easy", 1).map(lambda row: {**row, "seed": 14})
    trainer = Scripted(
        model=Qwen2ForCausalLM(config),
        processing_class=words,
        train_dataset=data,
        environment_factory=DroneEnvironment,
        args=GRPOConfig(
            output_dir=str(tmp_path),
            per_device_train_batch_size=4,
            num_generations=4,
            max_steps=1,
            max_completion_length=2000,
            learning_rate=1.0,
            report_to=[],
            logging_steps=1,
            use_cpu=True,
            bf16=False,
            save_strategy="no",
        ),
    )
    before = [p.detach().clone() for p in trainer.model.parameters()]
    trainer.train()
    (log,) = [entry for entry in trainer.state.log_history if "reward" in entry]
    # The flight with the wrong word is paid like the best one: it costs no step.
    pay = [paid(best), paid(best[:1]), paid(best), paid([])]
    assert log["rewards/DroneEnvironment/mean"] == pytest.approx(sum(pay) / 4)
    assert log["tools/failure_frequency"] == pytest.approx(1 / sum(map(len, routes)))
    assert any(bool((p != q).any()) for p, q in zip(before, trainer.model.parameters(), strict=True))
    assert all('"name": "fly"' in text and '"enum": ["UP"' in text for text in asked)
    assert any("Mission accomplished" in text for text in asked)
    assert any("'NORTH' is no direction" in text for text in asked)
