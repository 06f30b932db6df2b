"""TOML that is refused with a short reason."""

from decimal import Decimal

import pytest

from drone_env.errors import InvalidValueError
from drone_env.toml_text import parse_toml

REFUSED = {
    "an open long string": ('x = """' + 'a""' * (1 << 15), "Unterminated string"),
    "an exponent": ("x = 1e99999999999999999999", "exponent"),
    "a lone surrogate": ("# \ud800", "surrogates not allowed"),
    "no UTF-8": (b"x = '\xff'", "utf-8"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_toml_is_refused(name: str) -> None:
    text, why = REFUSED[name]
    with pytest.raises(InvalidValueError, match=rf"invalid TOML: .*{why}") as raised:
        parse_toml(text, parse_float=Decimal)
    assert len(str(raised.value)) < 200
