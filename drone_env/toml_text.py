"""Parse untrusted TOML. Text that could be expensive to parse is rejected first.

The time and memory of `tomllib` grow with the square of the length of a dotted key, and with each table, key and
element. The files of this package are flat: a few keys, and one list of rows.
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

MOST_TEXTS, LONGEST_TEXT, LONGEST_WORD = 5120, 1 << 16, 64
"""Maximum number of strings and comments, characters of each, and characters of a bare key or number."""
MOST = {
    r"\n": (4096, "lines"),
    r"[\w+-]+": (1024, "keys and numbers"),
    r"\.": (64, "dots outside strings"),
    r"[\[{]": (64, "tables and lists"),
    "=": (64, "keys"),
    ",": (1024, "commas"),
}
"""Maximum number of matches outside strings and comments, about twice that of the largest city, and their name."""
TEXT = re.compile(
    r"""  \"{3} [^"\\]* (?: (?: \\. | "{1,2}(?!") ) [^"\\]* )* "{3,5}
        | '{3} [^']* (?: '{1,2}(?!') [^']* )* '{3,5}
        | (?!"{3}) " [^"\\\n]* (?: \\. [^"\\\n]* )* "
        | (?!'{3}) ' [^'\n]* '
        | \#[^\n]*
        | (?P<unclosed>["'].*)""",
    re.VERBOSE | re.DOTALL,
)
"""A string or a comment, as in `tomllib`. The last alternative matches the rest, so that the search stops there."""


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
        _require_simple(text)
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


def _require_simple(text: str) -> None:
    for number, found in enumerate(TEXT.finditer(text)):
        if found["unclosed"]:
            raise ValueError("a string is not closed")
        if number == MOST_TEXTS or found.end() - found.start() > LONGEST_TEXT:
            raise ValueError(f"it has more than {MOST_TEXTS} strings, or one of more than {LONGEST_TEXT} characters")
    bare = TEXT.sub(" ", text)
    for pattern, (most, plural) in MOST.items():
        if sum(1 for _ in re.finditer(pattern, bare)) > most:
            raise ValueError(f"it has more than {most} {plural}")
    if re.search(rf"[\w+-]{{{LONGEST_WORD + 1}}}", bare):
        raise ValueError(f"it has a word of more than {LONGEST_WORD} characters")
