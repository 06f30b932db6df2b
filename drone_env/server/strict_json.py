"""JSON as the standard has it: no NaN, no Infinity, no key twice, nothing nested deeply."""

import json
from collections import Counter
from typing import Any, cast

from drone_env.errors import InvalidValueError

MAX_DEPTH = 32


def _no_constant(name: str) -> Any:
    raise ValueError(f"{name} is not JSON")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        counts = Counter(name for name, _ in pairs)
        twice = next(name for name, _ in pairs if counts[name] > 1)
        raise ValueError(f"the key {twice!r} stands there twice")
    return found


_DECODER = json.JSONDecoder(parse_constant=_no_constant, object_pairs_hook=_unique)


def parse_json(text: str) -> Any:
    """The value of a JSON text.

    Raises:
        InvalidValueError: if it is not JSON, or nested deeper than `MAX_DEPTH`; the message says what is wrong.
    """
    try:
        value = _DECODER.decode(text)
        if _depth(value) <= MAX_DEPTH:
            return value
    except ValueError as error:
        raise InvalidValueError(f"not JSON: {error}") from None
    except RecursionError:
        pass
    raise InvalidValueError(f"JSON may be nested {MAX_DEPTH} deep")


def _depth(value: Any) -> int:
    if isinstance(value, dict):
        value = list(cast(dict[str, Any], value).values())
    return 1 + max(map(_depth, cast(list[Any], value)), default=0) if isinstance(value, list) else 0
