"""Post-train a tiny language model on two cores: supervised fine-tuning, then GRPO, then honest evaluation.

    pip install -e '.[llm,trl]' accelerate
    python examples/post_train.py                              # sft weak grpo evaluate
    python examples/post_train.py sft --maps 500 --seed 1      # one stage
    python examples/post_train.py --model Qwen/Qwen3-0.6B --device cuda --batch 16 --lr 2e-5   # a model from the hub

Without `--model` nothing is downloaded: the model is a Llama of about a million parameters with random weights, and its
tokenizer has one word per phrase of the prompt `compass`. Its chat template shows it only the compass of each request;
`drone-env infer --prompt compass` sends the same messages, so the model is evaluated on what it learned.

Each stage reads and writes folders in `--out`: `sft` and `weak` (the same training, cut short), `grpo-REWARD-SEED`, and
`results.json`. `transformers serve FOLDER` serves any of them. docs/post_training.md shows what was measured.
"""

import json
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
import tyro
from datasets import Dataset, IterableDataset
from tokenizers import Regex, Tokenizer, decoders, models, pre_tokenizers, trainers
from transformers import AutoModelForCausalLM, AutoTokenizer, LlamaConfig, LlamaForCausalLM, PreTrainedTokenizerFast
from trl import GRPOConfig, GRPOTrainer, SFTConfig, SFTTrainer

from drone_env.agents import make_agent
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.seeds import split_seeds
from drone_env.llm.answers import Answer, read_answer
from drone_env.llm.prompt import Prompt, get_prompt
from drone_env.planning.optimal import solve, solver_of
from drone_env.results.statistics import DIFFERENCES, SCORES, crossed, interval

Stage = Literal["sft", "weak", "grpo", "evaluate"]
Reward = Literal["score", "regret", "rank"]
Pilot = Callable[[list[list[Any]]], list[Action]]
"""Answers many requests at once."""
RULES = "greedy", "nearest"
PHRASES = (
    r"(?:pad|parcel) (?:left|right) \d+ (?:up|down) \d+|cost \d+ via [A-Z]+|(?:battery|left) \d+"
    r"|(?:UP|DOWN|LEFT|RIGHT) [a-z]+|Below the drone: [a-z]+(?: pad)?|<[a-z]+>|\S+"
)
"""The words of the tiny model."""
CHAT_TEMPLATE = """
{%- for message in messages %}
{%- if message.role == 'user' %}{{ message.content.split('Compass:\\n')[-1] }}
{%- elif message.role == 'assistant' %} <answer> {{ message.content }} <end>{% endif %}
{%- endfor %}
{%- if add_generation_prompt %} <answer>{% endif %}"""


@dataclass(frozen=True)
class Options:
    """Options of all stages.

    Attributes:
        out: Folder of all models and results.
        task: The task.
        prompt: The prompt; the tiny model needs `compass`.
        model: A model of the hub, or a folder. None: a tiny model with random weights.
        device: `cpu` or `cuda`.
        seed: Seed of maps' actions, weights and order.
        maps: Number of train maps for supervised fine-tuning.
        mistakes: Share of random actions in these flights; every answer to learn is optimal all the same.
        batch: Answers per gradient step of supervised fine-tuning.
        epochs: Passes over the answers.
        lr: Its learning rate.
        weak_maps: Number of train maps of the weaker model, from which GRPO starts.
        rewards: Rewards of GRPO to compare.
        grpo_seeds: Number of seeds of each reward.
        grpo_steps: Gradient steps of GRPO.
        grpo_batch: States per step.
        generations: Answers per state.
        grpo_lr: Its learning rate.
        width: Width of the tiny model.
        layers: Its number of layers.
        test_maps: Number of test maps.
        quick: All sizes as small as possible, to test that everything runs.
    """

    out: Path = Path("post-train")
    task: str = "skyline_easy"
    prompt: str = "compass"
    model: str | None = None
    device: Literal["cpu", "cuda"] = "cpu"
    seed: int = 0
    maps: int = 6000
    mistakes: float = 0.15
    batch: int = 64
    epochs: float = 1.0
    lr: float = 1e-3
    weak_maps: int = 500
    rewards: tuple[Reward, ...] = ("score", "regret", "rank")
    grpo_seeds: int = 3
    grpo_steps: int = 120
    grpo_batch: int = 64
    generations: int = 4
    grpo_lr: float = 1e-4
    width: int = 128
    layers: int = 4
    test_maps: int = 1000
    quick: bool = False

    @property
    def answer_tokens(self) -> int:
        """Length of an answer in tokens; the tiny model has a word and an end."""
        return 8 if self.model else 2


QUICK = {
    "maps": 6, "weak_maps": 3, "batch": 32, "grpo_steps": 1, "grpo_batch": 4, "generations": 4,
    "grpo_seeds": 1, "width": 32, "layers": 1, "test_maps": 3,
}  # fmt: skip
"""Options of `--quick`."""


def states(options: Options, maps: int) -> Iterator[tuple[list[Any], Any]]:
    """Yield each state of flights over train maps, flown by random optimal actions with `mistakes`: messages and Q*."""
    prompt, rng = get_prompt(options.prompt), np.random.default_rng(options.seed)
    for seed in split_seeds("train", maps):
        flight = Episode(options.task, seed=seed)
        solver = solver_of(flight)
        while not flight.ended:
            values = solver.q_values(flight)
            yield prompt.messages(flight), values
            wrong = rng.random() < options.mistakes
            flight.step(Action(rng.integers(len(Action))) if wrong else best_of(values, rng))


def best_of(values: Any, rng: np.random.Generator) -> Action:
    """A random one of the optimal actions."""
    return Action(rng.choice(np.flatnonzero(values >= values.max() - 1e-12)))


def chat_data(options: Options, maps: int) -> Dataset:
    """Requests and optimal answers, as `SFTTrainer` expects them."""
    rng = np.random.default_rng(options.seed)

    def rows() -> Iterator[dict[str, Any]]:
        for messages, values in states(options, maps):
            answer = {"role": "assistant", "content": best_of(values, rng).name}
            yield {"prompt": messages, "completion": [answer]}

    return Dataset.from_list(list(rows()))


def tiny_tokenizer(data: Dataset) -> PreTrainedTokenizerFast:
    """A tokenizer whose words are the phrases of these conversations."""
    inner = Tokenizer(models.WordLevel(unk_token="<unknown>"))
    inner.pre_tokenizer = pre_tokenizers.Split(Regex(PHRASES), "removed", invert=True)
    inner.decoder = decoders.Fuse()
    special = ["<pad>", "<end>", "<unknown>", "<answer>"]
    compasses = (row["prompt"][-1]["content"].split("Compass:\n")[-1] for row in data)
    words = [action.name for action in Action]
    inner.train_from_iterator([*compasses, *words], trainers.WordLevelTrainer(special_tokens=special))
    return PreTrainedTokenizerFast(
        tokenizer_object=inner,
        pad_token="<pad>",
        eos_token="<end>",
        unk_token="<unknown>",
        padding_side="left",
        chat_template=CHAT_TEMPLATE,
    )


def load(options: Options, folder: str | Path) -> tuple[Any, Any]:
    """A model and its tokenizer."""
    tokenizer = AutoTokenizer.from_pretrained(folder, padding_side="left")
    return AutoModelForCausalLM.from_pretrained(folder, dtype="float32").to(options.device), tokenizer


def new_model(options: Options, data: Dataset) -> tuple[Any, Any]:
    """The model to fine-tune, and its tokenizer."""
    if options.model:
        return load(options, options.model)
    tokenizer = tiny_tokenizer(data)
    config = LlamaConfig(
        vocab_size=len(tokenizer),
        hidden_size=options.width,
        intermediate_size=options.width * 7 // 2,
        num_hidden_layers=options.layers,
        num_attention_heads=4,
        max_position_embeddings=256,
        tie_word_embeddings=True,
        bos_token_id=None,
        eos_token_id=tokenizer.eos_token_id,
        pad_token_id=tokenizer.pad_token_id,
    )
    return LlamaForCausalLM(config).to(options.device), tokenizer


def common(options: Options, out: Path, seed: int) -> dict[str, Any]:
    """Arguments of both trainers."""
    return {
        "output_dir": str(out),
        "seed": seed,
        "use_cpu": options.device == "cpu",
        "bf16": options.device == "cuda",
        "gradient_checkpointing": False,
        "save_strategy": "no",
        "report_to": "none",
        "logging_steps": 20,
        "adam_beta2": 0.95,
        "weight_decay": 0.05,
        "max_grad_norm": 1.0,
        "lr_scheduler_type": "cosine",
    }


def fine_tune(options: Options, name: str, maps: int) -> None:
    """Train on optimal answers, and save the model in the folder `name`."""
    torch.manual_seed(options.seed)
    started, data = time.process_time(), chat_data(options, maps)
    made, out = time.process_time(), options.out / name
    model, tokenizer = new_model(options, data)
    print(f"{name}: {len(data):,} answers, {model.num_parameters():,} parameters", flush=True)
    steps = max(1, int(options.epochs * len(data) / options.batch))
    args = SFTConfig(
        **common(options, out, options.seed),
        per_device_train_batch_size=options.batch,
        learning_rate=options.lr,
        max_steps=steps,
        warmup_steps=min(100, steps // 4),
        completion_only_loss=True,
    )
    trainer = SFTTrainer(model=model, args=args, train_dataset=data, processing_class=tokenizer)
    trainer.train()
    trainer.save_model(str(out))
    cost = {"answers": len(data), "flights_cpu_s": made - started, "training_cpu_s": time.process_time() - made}
    note(options, {name: cost | {"log": losses(trainer)}})


def losses(trainer: Any) -> list[dict[str, float]]:
    """The trainer's log of losses and rewards."""
    kept = ("step", "loss", "reward", "frac_reward_zero_std", "unusable")
    return [{key: row[key] for key in kept if key in row} for row in trainer.state.log_history if "loss" in row]


def pilot(options: Options, model: Any, tokenizer: Any) -> Pilot:
    """Make a function that answers many requests at once, without sampling. An unusable answer is a WAIT."""
    prompt = get_prompt(options.prompt)

    def choose(requests: list[Any]) -> list[Action]:
        texts = tokenizer.apply_chat_template(requests, add_generation_prompt=True, tokenize=False)
        inputs = tokenizer(texts, return_tensors="pt", padding=True, add_special_tokens=False).to(model.device)
        inputs.pop("token_type_ids", None)
        with torch.no_grad():
            answers = model.generate(
                **inputs, max_new_tokens=options.answer_tokens, pad_token_id=tokenizer.pad_token_id, do_sample=False
            )
        answers = tokenizer.batch_decode(answers[:, inputs["input_ids"].shape[1] :], skip_special_tokens=True)
        actions = [action_of(prompt, text) for text in answers]
        return [Action.WAIT if action is None else action for action in actions]

    return choose


def action_of(prompt: Prompt, text: str) -> Action | None:
    """The action of an answer; None if it is unusable."""
    actions = read_answer(Answer(text=text), prompt.plan, prompt.marks).actions
    return actions[0] if actions else None


def fly(options: Options, flights: Sequence[Episode], choose: Pilot) -> None:
    """Fly all flights to their ends."""
    prompt = get_prompt(options.prompt)
    while flying := [flight for flight in flights if not flight.ended]:
        for flight, action in zip(flying, choose([prompt.messages(flight) for flight in flying]), strict=True):
            flight.step(action)


def reward_of(options: Options, kind: Reward, choose: Pilot) -> Callable[..., list[float]]:
    """The reward of an answer, as `GRPOTrainer` calls it; `values` and `flown` are columns of the dataset.

    - `score`: the score at the end if the model itself flies on after this answer, without sampling: no planner is
      necessary; 0 for all answers to a request if they are the same, which GRPO ignores anyway;
    - `regret`: Q* of the action minus V*, which only an exact oracle can pay;
    - `rank`: 1 for the best actions of this state, 0 for the worst ones; equal actions share a rank.

    An unusable answer gets what the worst usable one of its group gets, and 0 if all are unusable. A lower reward would
    strengthen the other answers even where they are the same, and the model would stop exploring.
    """
    prompt = get_prompt(options.prompt)

    def reward(
        completions: list[Any],
        values: list[list[float]],
        flown: list[list[int]],
        log_metric: Callable[[str, float], None] | None = None,
        **_: Any,
    ) -> list[float]:
        actions = [action_of(prompt, completion[0]["content"]) for completion in completions]
        if log_metric:
            log_metric("unusable", actions.count(None) / len(actions))
        starts = [tuple(start) for start in flown]
        if kind == "score":
            paid = flown_on(starts, actions)
        else:
            value_of = {"regret": lambda q: q - q.max(), "rank": rank}[kind]
            paid = [float(value_of(np.round(q, 12))[action or 0]) for q, action in zip(values, actions, strict=True)]
        rows = list(zip(starts, actions, paid, strict=True))
        usable = sorted(((start, pay) for start, action, pay in rows if action is not None), key=lambda row: -row[1])
        worst = dict(usable)
        return [worst.get(start, 0.0) if action is None else pay for start, action, pay in rows]

    def flown_on(starts: list[tuple[int, ...]], actions: list[Action | None]) -> list[float]:
        keys = [(*start, action) for start, action in zip(starts, actions, strict=True)]
        usable = {key for key in keys if key[-1] is not None}
        different = Counter(key[:-1] for key in usable)
        flights = {key: Episode(options.task, seed=key[0]).fly(key[1:]) for key in usable if different[key[:-1]] > 1}
        fly(options, list(flights.values()), choose)
        return [flights[key].score if key in flights else 0.0 for key in keys]

    reward.__name__ = kind
    return reward


def rank(q: Any) -> Any:
    """The rank of each action by its value, from 0 (worst) to 1 (best)."""
    places = np.unique(q, return_inverse=True)[1]
    return places / max(1, places.max())


def visited(options: Options, seed: int, choose: Pilot, ended: list[float]) -> Iterator[dict[str, Any]]:
    """Yield the states that a model visits on train maps while it learns: each flight's state, then each one's next.

    Args:
        options: The options.
        seed: Seed of the maps.
        choose: The model's pilot.
        ended: Gets the score of each flight that ended.
    """
    prompt = get_prompt(options.prompt)
    seeds = split_seeds("train", 1 << 20, options.maps + (seed << 20))
    flights = [Episode(options.task, seed=seeds[number]) for number in range(options.grpo_batch)]
    fresh = iter(seeds[options.grpo_batch :])
    solvers = [solver_of(flight) for flight in flights]
    while True:
        messages = [prompt.messages(flight) for flight in flights]
        for request, flight, solver in zip(messages, flights, solvers, strict=True):
            yield {
                "prompt": request,
                "values": [float(value) for value in solver.q_values(flight)],
                "flown": [flight.seed, *flight.actions],
            }
        for number, action in enumerate(choose(messages)):
            flights[number].step(action)
            if flights[number].ended:
                ended.append(flights[number].score)
                flights[number] = Episode(options.task, seed=next(fresh))
                solvers[number] = solver_of(flights[number])


def reinforce(options: Options) -> None:
    """Train the weak model by GRPO on the states that it visits: each reward, each seed."""
    for seed in range(options.seed, options.seed + options.grpo_seeds):
        for kind in options.rewards:
            started, out = time.process_time(), options.out / f"grpo-{kind}-{seed}"
            model, tokenizer = load(options, options.out / "weak")
            choose, ended = pilot(options, model, tokenizer), list[float]()
            args = GRPOConfig(
                **common(options, out, seed),
                per_device_train_batch_size=options.grpo_batch * options.generations,
                num_generations=options.generations,
                max_completion_length=options.answer_tokens,
                max_steps=options.grpo_steps,
                learning_rate=options.grpo_lr,
                warmup_steps=options.grpo_steps // 10,
                temperature=1.0,
                shuffle_dataset=False,  # all flights move on together
            )
            trainer = GRPOTrainer(
                model=model,
                reward_funcs=reward_of(options, kind, choose),
                args=args,
                train_dataset=IterableDataset.from_generator(partial(visited, options, seed, choose, ended)),
                processing_class=tokenizer,
            )
            trainer.train()
            trainer.save_model(str(out))
            note(options, {out.name: {"cpu_s": time.process_time() - started, "log": losses(trainer), "ended": ended}})


def evaluate(options: Options) -> None:
    """Fly the test maps greedily with every model in the folder, next to two rules and the optimum."""
    seeds = split_seeds("test", options.test_maps)
    best = np.array([solve(options.task, seed).score for seed in seeds])
    flights = {name: [Episode(options.task, seed=seed) for seed in seeds] for name in RULES}
    for name in RULES:
        agent = make_agent(name, options.task)
        for flight in flights[name]:
            agent.reset(flight.seed)
            while not flight.ended:
                flight.step(agent.act(flight.observation()))
    for folder in sorted(path.parent for path in options.out.glob("*/config.json")):
        flights[folder.name] = [Episode(options.task, seed=seed) for seed in seeds]
        fly(options, flights[folder.name], pilot(options, *load(options, folder)))
    table: dict[str, Any] = {"optimum": {"score": list(interval(best, SCORES)), "ratio": 1.0}}
    for name, flown in flights.items():
        scores = np.array([flight.score for flight in flown])
        table[name] = {
            "score": list(interval(scores, SCORES)),
            "ratio": float(scores.mean() / best.mean()),
            "delivered_all": sum(flight.success for flight in flown) / len(flown),
            "ends": dict(Counter(flight.outcome.name for flight in flown)),
            "scores": scores.tolist(),
        }
        print(f"{name:20} score {scores.mean():.4f} ratio {table[name]['ratio']:.3f}", table[name]["ends"], flush=True)
    gains: dict[str, Any] = {}
    for kind in options.rewards if "weak" in table else ():
        runs = [np.array(row["scores"]) for name, row in table.items() if name.startswith(f"grpo-{kind}-")]
        if runs:
            gains[kind] = crossed(np.array(runs) - table["weak"]["scores"], DIFFERENCES)
            print(f"{kind} minus weak, over {len(runs)} seeds and all maps: {gains[kind]}", flush=True)
    note(options, {"evaluation": table, "gains": gains})


def note(options: Options, more: dict[str, Any]) -> None:
    """Add to `results.json`."""
    path = options.out / "results.json"
    known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    known |= {"options": asdict(options) | {"out": str(options.out)}} | more
    path.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")


def main(stages: tyro.conf.Positional[tuple[Stage, ...]], options: tyro.conf.OmitArgPrefixes[Options]) -> None:
    """Run the stages in order; without any, all of them."""
    if options.quick:
        options = replace(options, **QUICK)
    options.out.mkdir(parents=True, exist_ok=True)
    chosen: Sequence[Stage] = stages or ("sft", "weak", "grpo", "evaluate")
    if "sft" in chosen:
        fine_tune(options, "sft", options.maps)
    if "weak" in chosen:
        fine_tune(options, "weak", options.weak_maps)
    if "grpo" in chosen:
        reinforce(options)
    if "evaluate" in chosen:
        evaluate(options)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
