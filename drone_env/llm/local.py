"""A model of transformers in this process: answers the open requests of a run in batches."""

# Transformers is not installed where types are checked.
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false

import asyncio
import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import cache
from inspect import signature
from itertools import takewhile
from math import inf
from pathlib import Path
from time import process_time
from typing import Any

from drone_env.errors import InvalidValueError, needs
from drone_env.llm.answers import Answer
from drone_env.llm.sender import TryFailedError, changes_for

with needs("trl"):
    import torch
    import transformers  # pyright: ignore[reportMissingImports]

LIMITS = {"max_tokens", "max_completion_tokens"}
TEMPLATE = {"tools", "reasoning_effort"}
"""Fields of a request for the chat template."""
SENT = {"model", "messages", "temperature", "seed", "tool_choice", "chat_template_kwargs", *LIMITS, *TEMPLATE}
"""Fields of a request that are not passed on to `generate`."""
Request = Mapping[str, Any]


class LocalModel:
    """Answers the requests of a run with a local model, the open ones in batches.

    At temperature 0 it decodes greedily and answers equal requests once.

    Args:
        folder: The folder of a model: that of transformers, or one with a GGUF file.
        dtype: The type of its numbers, as `best_dtype` returns it.

    Raises:
        InvalidValueError: if the folder contains no model, or one without a chat template.
    """

    def __init__(self, folder: Path, dtype: str) -> None:
        files = {} if (folder / "config.json").exists() else {"gguf_file": _gguf_file(folder).name}
        transformers.utils.logging.disable_progress_bar()
        try:
            self.tokenizer = transformers.AutoTokenizer.from_pretrained(folder, padding_side="left", **files)
            self.model: Any = transformers.AutoModelForCausalLM.from_pretrained(folder, dtype=dtype, **files)
        except (OSError, ValueError, ImportError) as error:
            raise InvalidValueError(f"{folder} is not a model that transformers reads: {error}") from None
        if not self.tokenizer.chat_template:
            raise InvalidValueError(f"{folder} has no chat template: chat_template.jinja contains it")
        self.model = self.model.to("cuda" if torch.cuda.is_available() else "cpu").eval()
        end = self.model.generation_config.eos_token_id
        ends: list[int] = end if isinstance(end, list) else [] if end is None else [end]
        self._ends = {*ends, self.tokenizer.eos_token_id}
        self._pad = self.tokenizer.eos_token_id if self.tokenizer.pad_token_id is None else self.tokenizer.pad_token_id
        self._open: list[tuple[Request, asyncio.Future[Answer]]] = []
        self._answered: dict[str, Answer] = {}
        self._batches: asyncio.Task[None] | None = None
        self._closed = False

    async def send(self, request: Request, call_id: str) -> Answer:
        """Answer one request, with those that are sent at the same time.

        Raises:
            TryFailedError: if the model cannot answer it.
        """
        future = asyncio.get_running_loop().create_future()
        self._open.append((request, future))
        if self._batches is None or self._batches.done():
            self._batches = asyncio.ensure_future(self._answer_open())
        return await future

    async def close(self) -> None:
        """Stop after the next token."""
        self._closed = True

    async def _answer_open(self) -> None:
        """Answer open requests until there is none."""
        while self._open:
            await asyncio.sleep(0)  # all flights send their next requests before
            taken, self._open = self._open, []
            answers = await asyncio.to_thread(self._answers, [request for request, _ in taken])
            for (_, future), answer in zip(taken, answers, strict=True):
                if future.cancelled():
                    continue
                if isinstance(answer, Answer):
                    future.set_result(answer)
                else:
                    future.set_exception(answer)

    def _answers(self, requests: Sequence[Request]) -> list[Answer | TryFailedError]:
        """The answer to each request, or why there is none."""
        keys = [json.dumps(request, sort_keys=True) for request in requests]
        found: dict[int, Answer | TryFailedError] = {}
        groups: dict[str, dict[int, list[int]]] = {}
        for number, (key, request) in enumerate(zip(keys, requests, strict=True)):
            if key in self._answered or (not request.get("temperature") and key in keys[:number]):
                continue
            try:
                tokens = self._tokens(request)
            except Exception as error:  # a chat template can fail in as many ways as a program
                found[number] = TryFailedError(400, str(error), fatal=True, changes=changes_for(str(error), request))
                continue
            options = {name: value for name, value in request.items() if name != "messages"}
            groups.setdefault(json.dumps(options, sort_keys=True), {})[number] = tokens
        for options, group in groups.items():
            size = 16 if self.model.device.type == "cpu" else len(group)  # a processor also computes the padding
            order = sorted(group, key=lambda number: len(group[number]))
            for part in (order[start : start + size] for start in range(0, len(order), size)):
                try:
                    answers = self._generate([group[number] for number in part], json.loads(options))
                    found |= dict(zip(part, answers, strict=True))
                except (ValueError, TypeError, RuntimeError) as error:
                    found |= dict.fromkeys(part, TryFailedError(0, f"{type(error).__name__}: {error}", fatal=True))
        for number, answer in found.items():
            if isinstance(answer, Answer) and not requests[number].get("temperature"):
                self._answered[keys[number]] = answer
        return [
            found.get(number) or self._answered.get(key) or found[keys.index(key)] for number, key in enumerate(keys)
        ]

    def _tokens(self, request: Request) -> list[int]:
        """The tokens of a request, up to the beginning of the answer."""
        if "response_format" in request:
            raise ValueError("a local model gives no structured output: use --answers text")
        made = self.tokenizer.apply_chat_template(
            request["messages"],
            add_generation_prompt=True,
            return_dict=True,
            **{name: request[name] for name in TEMPLATE & request.keys()},
            **request.get("chat_template_kwargs", {}),
        )
        return made["input_ids"]

    def _generate(self, prompts: Sequence[Sequence[int]], options: Mapping[str, Any]) -> list[Answer]:
        """The answers to requests with equal options."""
        longest, temperature = max(map(len, prompts)), options.get("temperature")
        following = next((options[name] for name in LIMITS & options.keys()), 1024)
        sampling: dict[str, Any] = {"do_sample": temperature != 0}
        if temperature:
            sampling["temperature"] = temperature
        if "seed" in options:
            torch.manual_seed(options["seed"])
        with torch.inference_mode():
            shared, read = read_shared(self.model, prompts, following)
            padding = [(tokens[:shared], longest - len(tokens), tokens[shared:]) for tokens in prompts]
            ids = [[*start, *[self._pad] * missing, *rest] for start, missing, rest in padding]
            mask = [[1] * len(start) + [0] * missing + [1] * len(rest) for start, missing, rest in padding]
            made = self.model.generate(
                input_ids=torch.tensor(ids, device=self.model.device),
                attention_mask=torch.tensor(mask, device=self.model.device),
                max_new_tokens=following,
                eos_token_id=sorted(self._ends),
                pad_token_id=self._pad,
                stopping_criteria=[self._is_stopped],
                **read,
                **sampling,
                **{name: value for name, value in options.items() if name not in SENT},
            )
        return [self._answer(len(tokens), row[longest:]) for tokens, row in zip(prompts, made.tolist(), strict=True)]

    def _is_stopped(self, ids: Any, scores: Any) -> Any:
        """For each answer so far, whether it ends early; as `generate` calls it."""
        return torch.full((len(ids),), self._closed, device=ids.device)

    def _answer(self, prompt: int, tokens: Sequence[int]) -> Answer:
        """The answer in the tokens after a request, which padding follows."""
        end = next((place for place, token in enumerate(tokens, 1) if token in self._ends), None)
        return Answer(
            text=self.tokenizer.decode(tokens[:end], skip_special_tokens=True),
            finish_reason="length" if end is None else "stop",
            prompt_tokens=prompt,
            completion_tokens=len(tokens) if end is None else end,
        )


def read_shared(model: Any, requests: Sequence[Sequence[int]], following: float = inf) -> tuple[int, dict[str, Any]]:
    """Read the first tokens that all requests share once.

    Args:
        model: A causal language model of transformers.
        requests: The tokens of each request.
        following: Maximum number of tokens after the longest request.

    Returns:
        The number of these tokens, and the argument with which the model continues all requests. The number is 0 for
        one request, and for a model with layers that do not see all earlier tokens, such as a window of the last 512.
    """
    places = zip(*(tokens[:-1] for tokens in requests), strict=False)
    shared = sum(1 for _ in takewhile(lambda tokens: len(set(tokens)) == 1, places))
    if not shared or len(requests) == 1:
        return 0, {}
    layers = transformers.DynamicCache(config=model.config)
    windows = [getattr(layer, "sliding_window", inf) for layer in layers.layers]
    known = {transformers.cache_utils.DynamicLayer, transformers.cache_utils.DynamicSlidingWindowLayer}
    if min(windows) < max(map(len, requests)) + following or not known.issuperset(map(type, layers.layers)):
        return 0, {}
    decoder = model.get_decoder()
    name = "cache" if "cache" in signature(decoder.forward).parameters else "past_key_values"
    decoder(input_ids=torch.tensor([requests[0][:shared]], device=model.device), use_cache=True, **{name: layers})
    layers.batch_repeat_interleave(len(requests))
    return shared, {name: layers}


def model_digest(folder: Path) -> str:
    """SHA-256 of the files of a model, 16 hex digits."""
    digest = hashlib.sha256()
    for path in sorted(
        path for path in folder.iterdir() if path.suffix in (".json", ".safetensors", ".gguf", ".jinja")
    ):
        digest.update(path.name.encode())
        with path.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()[:16]


@cache
def best_dtype() -> str:
    """`bfloat16` where products of its matrices are faster than those of `float32`, and on a GPU."""
    if torch.cuda.is_available():
        return "bfloat16"
    seconds: dict[str, float] = {}
    for dtype in (torch.bfloat16, torch.float32):
        a, b = torch.ones(256, 1024, dtype=dtype), torch.ones(1024, 1024, dtype=dtype)
        for _ in range(5):
            started = process_time()
            torch.matmul(a, b)
            taken, name = process_time() - started, str(dtype).removeprefix("torch.")
            seconds[name] = min(taken, seconds.get(name, taken))
    return min(seconds, key=seconds.__getitem__)


def _gguf_file(folder: Path) -> Path:
    """The one GGUF file of a folder."""
    files = sorted(folder.glob("*.gguf"))
    if len(files) != 1:
        raise InvalidValueError(f"{folder} must contain config.json or one GGUF file, it has {len(files)}")
    return files[0]
