"""Parse TOML and validate it."""

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

from drone_env.errors import InvalidValueError, text_of

if TYPE_CHECKING:
    from pydantic import BaseModel

    Model = TypeVar("Model", bound=BaseModel)

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def parse_toml(content: str | bytes, parse_float: Callable[[str], Any] = float) -> dict[str, Any]:
    """Parse a TOML text.

    Args:
        content: The text, or its UTF-8.
        parse_float: Converts the text of a number with a dot or an exponent.
    """
    try:
        # Surrogates in a text raise UnicodeEncodeError.
        text = (content.encode() if isinstance(content, str) else content).decode("utf-8-sig")
        return tomllib.loads(text, parse_float=parse_float)
    except (ValueError, RecursionError, ArithmeticError) as error:
        raise InvalidValueError(f"invalid TOML: {error}") from None


def read_toml(content: str | bytes, model: "type[Model]", parse_float: Callable[[str], Any] = float) -> "Model":
    """Parse a TOML text and validate it."""
    from pydantic import ValidationError  # slow to load

    table = parse_toml(content, parse_float)
    try:
        return model.model_validate(table)
    except ValidationError as error:
        raise InvalidValueError(text_of(error)) from None
