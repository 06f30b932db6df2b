"""Parse untrusted TOML. Text that could be expensive to parse is rejected first.

The time and memory of `tomllib` grow with the square of the length of a dotted key, and long integers take quadratic
time to print. All else is linear in the length of the text. The files of this package are flat.
"""

import re
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

from drone_env.errors import InvalidValueError, shown, text_of

if TYPE_CHECKING:
    from pydantic import BaseModel

    Model = TypeVar("Model", bound=BaseModel)

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

MOST_DOTS, LONGEST_WORD = 64, 64
"""Maximum number of dots outside strings and comments, and of characters of a bare key or number."""
TEXT = re.compile(
    r"""  \"{3} [^"\\]* (?: (?: \\. | "{1,2}(?!") ) [^"\\]* )* "{3,5}
        | '{3} [^']* (?: '{1,2}(?!') [^']* )* '{3,5}
        | (?!"{3}) " [^"\\\n]* (?: \\. [^"\\\n]* )* "
        | (?!'{3}) ' [^'\n]* '
        | \#[^\n]*
        | ["'].*""",
    re.VERBOSE | re.DOTALL,
)
"""A string or a comment, as in `tomllib`. The parser stops at the last alternative, an open string."""


def parse_toml(content: str | bytes, parse_float: Callable[[str], Any] = float) -> dict[str, Any]:
    """Parse a TOML text.

    Args:
        content: The text, or its UTF-8.
        parse_float: Converts the text of a number with a dot or an exponent.

    Raises:
        InvalidValueError: if it is not TOML, or more complex than files of this package.
    """
    try:
        # Surrogates in a text raise UnicodeEncodeError.
        text = (content.encode() if isinstance(content, str) else content).decode("utf-8-sig")
        bare = TEXT.sub(" ", text)
        if bare.count(".") > MOST_DOTS or re.search(rf"[\w+-]{{{LONGEST_WORD + 1}}}", bare):
            dots = f"more than {MOST_DOTS} dots outside strings"
            raise ValueError(f"it has {dots}, or a word of more than {LONGEST_WORD} characters")
        return tomllib.loads(text, parse_float=parse_float)
    except ArithmeticError:
        raise InvalidValueError("invalid TOML: the exponent of a number is too large") from None
    except (ValueError, RecursionError) as error:
        raise InvalidValueError(f"invalid TOML: {error}") from None


def read_toml(content: str | bytes, model: "type[Model]", parse_float: Callable[[str], Any] = float) -> "Model":
    """Parse a TOML text and validate it.

    Raises:
        InvalidValueError: if it is not TOML, or does not fit the model.
    """
    from pydantic import ValidationError  # slow to load

    table = parse_toml(content, parse_float)
    try:
        return model.model_validate(table)
    except ValidationError as error:
        unknown = [name for name in table if name not in model.model_fields]
        if unknown:
            allowed = ", ".join(model.model_fields)
            raise InvalidValueError(f"unknown key {shown(unknown[0])}; allowed: {allowed}") from None
        raise InvalidValueError(text_of(error)) from None
