"""From `--set NAME=VALUES` to the settings of a sweep."""

import itertools
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import NamedTuple, get_type_hints

import numpy as np
from pydantic import TypeAdapter, ValidationError

from drone_env.cluster.sweep.config import ELSEWHERE, Setting, Value
from drone_env.errors import InvalidValueError, UnknownNameError, text_of
from drone_env.rl.config import TrainConfig

ALIASES = {"lr": "learning_rate"}
SWEPT = tuple(field.name for field in fields(TrainConfig) if field.name not in ELSEWHERE)
RANGE = re.compile(r"(uniform|loguniform)\(([^,()]+),([^,()]+)\)")
MOST_SETTINGS = 10_000


class Axis(NamedTuple):
    """The values of one name, none for a range, and how one is drawn."""

    name: str
    values: list[Value]
    draw: Callable[[np.random.Generator], Value]


def parse_axis(text: str) -> Axis:
    """An axis from `NAME=VALUE,VALUE...`, `NAME=uniform(LOW,HIGH)` or `NAME=loguniform(LOW,HIGH)`.

    Raises:
        UnknownNameError: if training knows no such value; the message lists those that it knows.
        InvalidValueError: if the text has another form, or a value is not of the name's type.
    """
    given, equals, listed = text.partition("=")
    name = ALIASES.get(given.strip(), given.strip().replace("-", "_"))
    if not equals or not listed.strip():
        raise InvalidValueError(f"--set takes NAME=VALUE,VALUE... such as lr=1e-3,3e-4; got {text!r}")
    if name in ELSEWHERE:
        raise InvalidValueError(f"{name} is not set by --set but by {ELSEWHERE[name]}")
    if name not in SWEPT:
        raise UnknownNameError("setting", given.strip(), [*SWEPT, *ALIASES])
    found = RANGE.fullmatch("".join(listed.split()))
    if found:
        return Axis(name, [], _range(name, *found.groups()))
    values = [_value(name, value.strip()) for value in listed.split(",")]

    def draw(rng: np.random.Generator) -> Value:
        return values[int(rng.integers(len(values)))]

    return Axis(name, values, draw)


def settings_of(texts: Sequence[str], samples: int | None = None, samples_seed: int = 0) -> list[Setting]:
    """The settings: the whole grid, or this many drawn at random, of which those that come twice count once.

    Raises:
        UnknownNameError: if training knows no such value.
        InvalidValueError: if a text has another form, a name is there twice, a range has no `samples`, or there are
            more than 10,000 settings.
    """
    axes = [parse_axis(text) for text in texts]
    names = [axis.name for axis in axes]
    for name in names:
        if names.count(name) > 1:
            raise InvalidValueError(f"{name} is set twice: name all its values in one --set")
    if samples is not None:
        if not 1 <= samples <= MOST_SETTINGS:
            raise InvalidValueError(f"--samples must be from 1 to {MOST_SETTINGS}, got {samples}")
        if samples_seed < 0:
            raise InvalidValueError(f"--samples-seed must be 0 or more, got {samples_seed}")
        rng = np.random.default_rng(samples_seed)
        drawn = [{axis.name: axis.draw(rng) for axis in axes} for _ in range(samples)]
        return [setting for i, setting in enumerate(drawn) if setting not in drawn[:i]]
    for axis in axes:
        if not axis.values:
            raise InvalidValueError(f"{axis.name} is a range: say with --samples N how many settings to draw")
    if math.prod(len(axis.values) for axis in axes) > MOST_SETTINGS:
        raise InvalidValueError(f"the grid has more than {MOST_SETTINGS} settings; draw some with --samples N")
    return [dict(zip(names, values, strict=True)) for values in itertools.product(*(axis.values for axis in axes))]


def _value(name: str, text: str) -> Value:
    kind = get_type_hints(TrainConfig)[name]
    try:
        value: Value = TypeAdapter[Value](kind).validate_strings(text)
    except ValidationError as error:
        raise InvalidValueError(f"{name} cannot be {text!r}: {text_of(error)}") from None
    if isinstance(value, float) and not math.isfinite(value):
        raise InvalidValueError(f"{name} must be a finite number, got {text!r}")
    return value


def _range(name: str, form: str, low_text: str, high_text: str) -> Callable[[np.random.Generator], Value]:
    low, high = _value(name, low_text), _value(name, high_text)
    if isinstance(low, (bool, str)) or isinstance(high, (bool, str)):
        raise InvalidValueError(f"{name} is no number: name its values, separated by commas")
    if not (low < high and (low > 0 or form == "uniform")):
        raise InvalidValueError(f"{form}({low},{high}): the first must be the smaller, and above 0 for loguniform")
    whole = isinstance(low, int)

    def draw(rng: np.random.Generator) -> Value:
        drawn = math.exp(rng.uniform(math.log(low), math.log(high))) if form == "loguniform" else rng.uniform(low, high)
        return round(drawn) if whole else float(drawn)

    return draw
