"""TOML that somebody else wrote, refused before parsing if parsing it could be expensive.

`tomllib` takes time and memory that grow with the square of a dotted key, and with every table, key and element. The
files of this package are flat: a few keys, and one list of rows.
"""

import re
import sys
from collections import Counter
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

LONGEST_TEXT, LONGEST_WORD = 1 << 16, 64
"""Characters of a string, and of a bare key or number."""
MOST = {
    "string": (1024, "strings"),
    "comment": (4096, "comments"),
    "newline": (4096, "lines"),
    "word": (1024, "keys and numbers"),
    "dot": (64, "dots outside strings"),
    "bracket": (64, "tables and lists"),
    "equals": (64, "keys"),
    "comma": (1024, "commas"),
    "other": (8192, "signs"),
}
"""Maximum number of tokens of each kind, about twice that of the largest city, and their plural."""
TOKEN = re.compile(
    r"""(?P<string>
            \"{3} [^"\\]* (?: (?: \\. | "{1,2}(?!") ) [^"\\]* )* "{3,5}
          | '{3} [^']* (?: '{1,2}(?!') [^']* )* '{3,5}
          | (?!"{3}) " [^"\\\n]* (?: \\. [^"\\\n]* )* "
          | (?!'{3}) ' [^'\n]* '
        )
      | (?P<unclosed>["'])
      | (?P<comment>\#[^\n]*)
      | (?P<newline>\n)
      | (?P<word>[\w+-]+)
      | (?P<dot>\.)
      | (?P<bracket>[\[{])
      | (?P<equals>=)
      | (?P<comma>,)
      | (?P<other>[^"'\#\n\w+\-.\[{=,]+)""",
    re.VERBOSE | re.DOTALL,
)
"""Every character belongs to a token; strings and comments are those that `tomllib` finds."""


def parse_toml(content: str | bytes, parse_float: Callable[[str], Any] = float) -> dict[str, Any]:
    """The table in a TOML text.

    Args:
        content: The text, or its UTF-8.
        parse_float: Converts the text of a number with a dot or an exponent.

    Raises:
        InvalidValueError: if it is not TOML, or more complex than the files of this package are.
    """
    try:
        # A text may hold surrogates that UTF-8 cannot encode.
        text = (content.encode() if isinstance(content, str) else content).decode("utf-8-sig")
        _require_simple(text)
        return tomllib.loads(text, parse_float=parse_float)
    except ArithmeticError:
        raise InvalidValueError("not TOML that can be read: the exponent of a number is too large") from None
    except (ValueError, RecursionError) as error:
        raise InvalidValueError(f"not TOML that can be read: {error}") from None


def read_toml(content: str | bytes, model: "type[Model]", parse_float: Callable[[str], Any] = float) -> "Model":
    """Parse a TOML text and validate it.

    Raises:
        InvalidValueError: if it is not TOML, or does not fit the model; the message names the keys that are allowed.
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
    found: Counter[str] = Counter()
    for token in TOKEN.finditer(text):
        kind = str(token.lastgroup)
        if kind == "unclosed":
            raise ValueError("a string is not closed")
        found[kind] += 1
        most, plural = MOST[kind]
        if found[kind] > most:
            raise ValueError(f"it has more than {most} {plural}")
        longest = {"string": LONGEST_TEXT, "word": LONGEST_WORD}.get(kind)
        if longest is not None and token.end() - token.start() > longest:
            raise ValueError(f"it has a {kind} of more than {longest} characters")
