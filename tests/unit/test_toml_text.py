"""TOML that is refused with a short reason."""

from decimal import Decimal

import pytest

from drone_env.errors import InvalidValueError
from drone_env.toml_text import parse_toml


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("x = 1e99999999999999999999", "decimal"),
        ("x = " + "[" * 100_000, "recursion|deep"),
        ("# \ud800", "surrogates not allowed"),
        (b"x = '\xff'", "utf-8"),
    ],
)
def test_a_text_that_cannot_be_read_is_refused(text: str | bytes, why: str) -> None:
    with pytest.raises(InvalidValueError, match=rf"invalid TOML: .*({why})") as raised:
        parse_toml(text, parse_float=Decimal)
    assert len(str(raised.value)) < 200
