"""Turn the arguments of a command into its call, and what is wrong with them into one short error."""

import io
import re
from ast import literal_eval
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from difflib import get_close_matches
from functools import partial, wraps
from inspect import get_annotations, signature
from itertools import dropwhile, takewhile
from typing import Annotated, Any

import tyro

from drone_env.errors import InvalidValueError, UnknownNameError

NOT_A_NUMBER = re.compile(
    r"Error parsing (\S+): .*?(?:invalid literal for (int)\(\) with base 10|could not convert string to float): (.+)"
)
NO_CHOICE = re.compile(r"invalid choice '(.*)' for argument '(.+)'\. Expected one of (\(.+\)) ?\.")
UNRECOGNISED = re.compile(r"Unrecognized options: ([^\s,]+)")
MISSING = re.compile(r"Missing from .+?: (--\S+)")
NO_VALUE = re.compile(r"Missing value for argument '(.+)'\.")


def parsed(command: Callable[..., int | None], program: str, arguments: Sequence[str]) -> Callable[[], int | None]:
    """The call of a command with these arguments; `--help` prints its manual and exits.

    Raises:
        InvalidValueError: if an option is unknown or missing, or has no such value.
        UnknownNameError: if an option takes one of some words, and this is none of them.
    """
    hints = get_annotations(command, eval_str=True)
    optional = tyro.conf.arg(help_behavior_hint="(optional)")  # instead of "(default: None)"
    unset = [name for name, parameter in signature(command).parameters.items() if parameter.default is None]

    @wraps(command)
    def call(*args: Any, **options: Any) -> Callable[[], int | None]:
        return partial(command, *args, **options)

    del call.__wrapped__  # whose hints would be read instead of these
    call.__signature__ = signature(command)  # type: ignore[attr-defined]
    call.__annotations__ = hints | {name: Annotated[hints[name], optional] for name in unset}

    def parse(words: Sequence[str]) -> Callable[[], int | None]:
        return tyro.cli(call, prog=program, args=words, config=[tyro.conf.DisallowNone])

    refused = io.StringIO()
    try:
        with redirect_stderr(refused):
            return parse(arguments)
    except SystemExit as ended:
        if not ended.code:
            raise
    manual = io.StringIO()
    with redirect_stdout(manual), suppress(SystemExit):
        parse(["--help"])
    raise _error(_first_part(refused.getvalue()), program, re.findall(r"--[a-z][a-z0-9-]*", manual.getvalue()))


def _first_part(box: str) -> str:
    """What a box of tyro says between its title and its next rule, in one line."""
    lines = [line.strip("│╰╯ ") for line in box.splitlines()[1:]]
    # Without UTF-8 a box has no sides, and a rule below its title.
    below = dropwhile(_is_rule, lines)
    return " ".join(" ".join(takewhile(lambda line: not _is_rule(line), below)).split())


def _is_rule(line: str) -> bool:
    return line.startswith(("──", "----"))


def _error(told: str, program: str, options: Sequence[str]) -> InvalidValueError | UnknownNameError:
    manual = f"see {program} --help"
    if found := NOT_A_NUMBER.search(told):
        return InvalidValueError(f"{found[1]} takes {'an integer' if found[2] else 'a number'}, got {found[3]}")
    if found := NO_CHOICE.search(told):
        return UnknownNameError(found[2], found[1], literal_eval(found[3]))
    if found := MISSING.search(told):
        return InvalidValueError(f"{found[1]} is missing; {manual}")
    if found := NO_VALUE.search(told):
        return InvalidValueError(f"{found[1]} needs a value; {manual}")
    if found := UNRECOGNISED.search(told):
        close = get_close_matches(found[1].partition("=")[0], options, 1) if found[1].startswith("-") else []
        kind = "option" if found[1].startswith("-") else "argument"
        return InvalidValueError(f"unknown {kind} {found[1]}; {f'did you mean {close[0]}? ' if close else ''}{manual}")
    return InvalidValueError(f"{told.removeprefix('Error parsing ')}; {manual}")
