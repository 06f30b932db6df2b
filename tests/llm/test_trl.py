"""The drone in TRL's own GRPOTrainer: `make adapters`, as TRL is no part of the development tools."""

import inspect
import sys
from pathlib import Path
from typing import Any

import pytest

from drone_env.core.actions import Action
from drone_env.core.state_manager import Episode
from drone_env.errors import EpisodeError, InvalidValueError, MissingPackageError, UnknownNameError
from drone_env.llm.trl_environment import DroneEnvironment, training_maps
from drone_env.planning.optimal import solve

CALL = '<tool_call>\n{{"name": "fly", "arguments": {{"direction": "{}"}}}}\n</tool_call>'


def test_a_flight_by_tool_calls() -> None:
    # Map 14 of easy by hand, as in the tests of `fly`.
    drone = DroneEnvironment()
    told = drone.reset(prompt=[], task="easy", seed=14)
    episode = Episode("easy")
    episode.reset(14)
    x, y = episode.position
    assert f"Position: ({x}, {y})" in told
    assert drone.fly("LEFT") == (
        f"On the way. Position: ({x - 1}, {y}). Battery: 59 units. Nearest parcel: {episode.target}. Delivered: 0 of 1."
    )
    assert drone.get_reward() == 0.01  # as if it waited to the end
    drone.fly("UP")
    assert drone.fly("UP") == "Delivered: 1 of 1. Mission accomplished."
    assert drone.get_reward() == 0.99
    assert drone.fly("DOWN").startswith("Nothing done: the episode has ended")
    assert drone.get_reward() == 0.99


def test_the_reward_is_what_the_profile_pays() -> None:
    for profile in ("score", "tiered", "aligned"):
        drone, episode = DroneEnvironment(profile), Episode("hard", profile)
        drone.reset(task="hard", seed=3)
        episode.reset(3)
        for action in solve("hard", 3).actions[:5]:
            drone.fly(action.name)
            episode.step(action)
        while not episode.ended:
            episode.step(Action.WAIT)
        assert drone.get_reward() == episode.reward_total


def test_what_trl_takes_for_tools_is_fly_alone() -> None:
    methods = [name for name, _ in inspect.getmembers(DroneEnvironment, inspect.isfunction) if name[0] != "_"]
    assert methods == ["fly", "get_reward", "reset"]


def test_bad_rows_and_directions_are_told() -> None:
    drone = DroneEnvironment()
    with pytest.raises(EpisodeError, match="reset"):
        drone.get_reward()
    with pytest.raises(InvalidValueError, match="columns task and seed"):
        drone.reset(prompt=[])
    drone.reset(task="easy", seed=1)
    for wrong in ("NORTH", "up", None, ["UP"]):
        with pytest.raises(InvalidValueError, match=r"is no direction\. Directions are UP"):
            drone.fly(wrong)  # type: ignore[arg-type]
    with pytest.raises(UnknownNameError, match="allowed"):
        DroneEnvironment("generous")


def test_without_the_package_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "datasets", None)
    with pytest.raises(MissingPackageError, match=r"-e .\.\[trl\]"):
        training_maps()


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


@pytest.mark.timeout(600)
@pytest.mark.filterwarnings("ignore")
def test_the_trainer_flies_scores_and_learns(tmp_path: Path) -> None:
    pytest.importorskip("trl", reason="not one of the development tools; make adapters has it")
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
    optimum = solve("easy", 14).score
    # The flight with the wrong word reaches the optimum too: it costs no step.
    assert log["rewards/DroneEnvironment/mean"] == pytest.approx((optimum + 0.01 + optimum + 0.01) / 4)
    assert log["tools/failure_frequency"] == pytest.approx(1 / sum(map(len, routes)))
    assert any(bool((p != q).any()) for p, q in zip(before, trainer.model.parameters(), strict=True))
    assert all('"name": "fly"' in text and '"enum": ["UP"' in text for text in asked)
    assert any("Mission accomplished" in text for text in asked)
    assert any("'NORTH' is no direction" in text for text in asked)
