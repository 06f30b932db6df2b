"""A secret taken out of texts that come from elsewhere, however an endpoint that quotes it has written it."""

import base64
import re
from functools import lru_cache

SHORTEST_SECRET = 8
"""Shorter tokens, such as the `x` that local servers are content with, are no secrets: they are parts of words."""
TAKEN_OUT = "***"
BETWEEN = r"[\W_]{0,3}"
"""What may stand between the digits of a character code, or a line break in a long word."""


def without_secret(text: str, secret: str | None) -> str:
    """The text with `***` in place of the secret.

    It is found in any case, also backwards, with characters escaped (as in URLs, HTML, JSON and mail), in base64 at any
    offset, and in hexadecimal.
    """
    if secret is None or len(secret) < SHORTEST_SECRET:
        return text
    return _forms(secret).sub(TAKEN_OUT, text)


@lru_cache(maxsize=8)
def _forms(secret: str) -> re.Pattern[str]:
    written = r"\s?".join(map(_character, secret))
    backwards = r"\s?".join(map(_character, reversed(secret)))
    hexadecimal = BETWEEN.join(f"{ord(letter):02x}" for letter in secret)
    coded = [_base64(spelling, offset) for spelling in (secret, secret.lower(), secret.upper()) for offset in range(3)]
    # To look at one character first is several times faster than to try all forms everywhere.
    begins = "".join(form[1:3] if form[0] == "[" else form[0] for form in coded)
    firsts = re.escape(secret[0] + secret[-1] + hexadecimal[0] + "%=\\&" + begins)
    return re.compile(f"(?=[{firsts}])(?:{'|'.join([written, backwards, hexadecimal, *coded])})", re.IGNORECASE)


def _character(letter: str) -> str:
    """One character as it is, or as an escape."""
    code = ord(letter)
    escapes = (
        rf"(?:%(?:25)*|=|\\{{1,4}}(?:x|u00|u\{{0*)|&#x0*){code:02x}[;}}]?",
        f"&#0*{code};?",
    )
    return f"(?:{'|'.join((re.escape(letter), *escapes))})"


def _base64(secret: str, offset: int) -> str:
    """The base64 of the secret behind this many other bytes, in either alphabet, perhaps on several lines.

    Without the digits at its ends that its neighbours decide, too: they show less than a character.
    """
    coded = base64.b64encode(b"\0" * offset + secret.encode()).decode().rstrip("=")
    first = -(-8 * offset // 6)
    last = 8 * (offset + len(secret)) // 6
    digits = ["[+-]" if digit == "+" else "[/_]" if digit == "/" else digit for digit in coded[first:last]]
    return r"\s*".join(digits)
