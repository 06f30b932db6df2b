"""Parse TOML and validate it."""

import re
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

from drone_env.errors import InvalidValueError, abbreviate, text_of

if TYPE_CHECKING:
    from pydantic import BaseModel

    Model = TypeVar("Model", bound=BaseModel)

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

LONG_NUMBER = re.compile(r"\b0[xob]\w{65}")
"""Printing a number takes quadratic time; Python limits decimal numbers itself."""


def parse_toml(content: str | bytes, parse_float: Callable[[str], Any] = float) -> dict[str, Any]:
    """Parse a TOML text.

    Args:
        content: The text, or its UTF-8.
        parse_float: Converts the text of a number with a dot or an exponent.
    """
    try:
        # Surrogates in a text raise UnicodeEncodeError.
        text = (content.encode() if isinstance(content, str) else content).decode("utf-8-sig")
        if LONG_NUMBER.search(text):
            raise ValueError("a number has more than 64 digits")
        return tomllib.loads(text, parse_float=parse_float)
    except ArithmeticError:
        raise InvalidValueError("invalid TOML: the exponent of a number is too large") from None
    except (ValueError, RecursionError) as error:
        raise InvalidValueError(f"invalid TOML: {error}") from None


def read_toml(content: str | bytes, model: "type[Model]", parse_float: Callable[[str], Any] = float) -> "Model":
    """Parse a TOML text and validate it."""
    from pydantic import ValidationError  # slow to load

    table = parse_toml(content, parse_float)
    try:
        return model.model_validate(table)
    except ValidationError as error:
        unknown = [name for name in table if name not in model.model_fields]
        if unknown:
            allowed = ", ".join(model.model_fields)
            raise InvalidValueError(f"unknown key {abbreviate(unknown[0])}; allowed: {allowed}") from None
        raise InvalidValueError(text_of(error)) from None
