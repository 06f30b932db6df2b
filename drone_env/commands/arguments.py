"""Arguments that several commands share, and how the arguments of a command become its call."""

import io
import re
import sys
from ast import literal_eval
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from difflib import get_close_matches
from functools import partial, wraps
from inspect import get_annotations, signature
from itertools import dropwhile, takewhile
from reprlib import repr as shortened
from typing import Annotated, Any

import tyro

from drone_env.agents import AGENTS
from drone_env.agents.named import sb3_file
from drone_env.core.rewards import REWARD_PROFILES
from drone_env.core.seeds import N_SEEDS, SPLITS, split_seeds
from drone_env.core.tasks import TASKS
from drone_env.errors import InvalidValueError, UnknownNameError

SHORT_NAMES = [task.short_name for task in TASKS.values()]

TASK = "|".join((*SHORT_NAMES, "CITY.toml"))
TaskName = Annotated[str, tyro.conf.arg(metavar=TASK)]
ChosenTask = Annotated[str | None, tyro.conf.arg(metavar=TASK)]
AGENT = "|".join((*AGENTS, "MODULE:NAME", "FILE.zip:WRAPPER"))
AgentName = Annotated[str, tyro.conf.arg(metavar=AGENT)]
AgentNames = Annotated[tuple[str, ...], tyro.conf.arg(metavar=AGENT)]
ChosenAgent = Annotated[str | None, tyro.conf.arg(metavar=AGENT)]
Split = Annotated[str, tyro.conf.arg(metavar="|".join(SPLITS))]
ClusterAddress = Annotated[str | None, tyro.conf.arg(metavar="local|auto|HOST:PORT")]
SplitName = Annotated[str | None, tyro.conf.arg(metavar="|".join(SPLITS))]
SeedRange = Annotated[str | None, tyro.conf.arg(metavar="A:B")]
PROFILE = "|".join((*REWARD_PROFILES, "FILE.toml"))
ProfileName = Annotated[str, tyro.conf.arg(metavar=PROFILE)]
ChosenProfile = Annotated[str | None, tyro.conf.arg(metavar=PROFILE)]
Seed = Annotated[int | None, tyro.conf.arg(metavar="N")]

NOT_A_NUMBER = re.compile(
    r"Error parsing (\S+): .*?(?:invalid literal for (int)\(\) with base 10|could not convert string to float): (.+)"
)
NO_CHOICE = re.compile(r"invalid choice '(.*)' for argument '(.+)'\. Expected one of (\(.+\)) ?\.")
UNRECOGNISED = re.compile(r"Unrecognized options: ([^\s,]+)")
MISSING = re.compile(r"Missing from .+?: (--\S+)")
NO_VALUE = re.compile(r"Missing value for argument '(.+)'\.")


@contextmanager
def own_profiles_forgotten() -> Generator[None, None, None]:
    """The reward profiles that a command's arguments register are known up to the end of the `with`."""
    before = dict(REWARD_PROFILES)
    try:
        yield
    finally:
        REWARD_PROFILES.clear()
        REWARD_PROFILES.update(before)


def say_trusted(agents: Iterable[str]) -> None:
    """Say on standard error of each file that is about to be unpickled that it is trusted."""
    for file in dict.fromkeys(filter(None, map(sb3_file, agents))):
        print(f"{file}: reading it runs code that it holds; it is trusted, since you name it", file=sys.stderr)


def parse_seeds(text: str) -> range:
    """The seeds of `A:B`, from A up to and not including B.

    Raises:
        InvalidValueError: if it is not of that form, or empty.
    """
    start, colon, stop = text.partition(":")
    numbers = [number for number in (start, stop) if number.isdecimal() and len(number) <= len(str(N_SEEDS))]
    if not (colon and len(numbers) == 2 and int(start) < int(stop) <= N_SEEDS):
        raise InvalidValueError(
            f"--seeds takes A:B with integers 0 <= A < B <= 2^53, such as 0:100; got {shortened(text)}"
        )
    return range(int(start), int(stop))


def chosen_maps(seeds: str | None, split: str | None, episodes: int | None, default: int) -> tuple[str, range]:
    """The split and the seeds that `--seeds`, `--split` and `--episodes` name; the split of `--seeds` is `custom`.

    Args:
        seeds: `A:B`.
        split: A split; None for test.
        episodes: How many of its first maps.
        default: The same, where nothing is said.

    Raises:
        InvalidValueError: if they contradict each other, or one is out of range.
    """
    if seeds is None:
        if episodes is not None and episodes < 1:
            raise InvalidValueError(f"--episodes must be at least 1, got {episodes}")
        return split or "test", split_seeds(split or "test", episodes or default)
    if split is not None or episodes is not None:
        raise InvalidValueError("--seeds names the maps itself: give it without --split and --episodes")
    return "custom", parse_seeds(seeds)


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
