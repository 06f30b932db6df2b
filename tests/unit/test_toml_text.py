"""Expensive TOML is rejected before parsing."""

import random
from decimal import Decimal

import pytest

from drone_env.errors import InvalidValueError
from drone_env.toml_text import parse_toml, tomllib

SIZE = 1 << 17
HOSTILE = {
    "a dotted key": ("a." * 65 + "a = 1", "64 dots outside strings"),
    "a quoted dotted key": ('"." . ' * 65 + "a = 1", "64 dots outside strings"),
    "a dotted key in a list": ("x = [{" + "a." * 65 + "a = 1}]", "64 dots outside strings"),
    "a long number": ("x = 0x" + "f" * SIZE, "word of more than 64"),
    "an open long string": ('x = """' + 'a""' * (SIZE // 3), "Unterminated string"),
    "an exponent": ("x = 1e99999999999999999999", "exponent"),
    "a lone surrogate": ("# \ud800", "surrogates not allowed"),
    "no UTF-8": (b"x = '\xff'", "utf-8"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_what_would_be_expensive_is_refused(name: str) -> None:
    text, why = HOSTILE[name]
    with pytest.raises(InvalidValueError, match=rf"invalid TOML: .*{why}") as raised:
        parse_toml(text, parse_float=Decimal)
    assert len(str(raised.value)) < 200


def test_strings_and_comments_hide_what_is_in_them() -> None:
    hidden = "[a.b] = {,} # " * 20
    text = f'x = "{hidden} \\" {hidden}" # {hidden}\ny = \'{hidden}\'\nz = """{hidden}\n"{hidden}"""""\n'
    assert parse_toml(text) == {"x": f'{hidden} " {hidden}', "y": hidden, "z": f'{hidden}\n"{hidden}""'}


def test_what_is_small_is_parsed_as_tomllib_does() -> None:
    """The scanner finds the same strings as the parser, so it counts every dot."""
    generator, parsed = random.Random(0), 0
    for _ in range(5_000):
        quote = generator.choice(['"', "'", '"""', "'''"])
        body = "".join(
            generator.choices(["a", "=", "'", '"', "\\\\", '\\"', "\n", "#", "[", "\\\n"], k=generator.randrange(8))
        )
        end = generator.choice(["", "'", '"', '""', " # '"])
        text = f"k = {quote}{body}{quote}{end}\n" + "x." * 65 + "y = 1\n"
        try:
            tomllib.loads(text)
        except tomllib.TOMLDecodeError:
            continue
        parsed += 1
        with pytest.raises(InvalidValueError, match="64 dots"):
            parse_toml(text)
    assert parsed > 500
