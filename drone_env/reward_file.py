"""Reward profiles from TOML files, for people who invent their own.

    id = "mine"
    summary = "deliveries pay, time costs"
    shaping = 0.05                # per cell closer to the target
    clamp = [-1.0, 1.0]           # bounds of event reward and shaping together
    shaping_gamma = 0.99          # potential-based shaping on top
    pays_score = false            # the graded score at the end
    task_events = false           # what the events not named below pay: the task's numbers, or 0

    [events]
    delivery = 1.0
    step = -0.01

Every key but `id` may be left out.
"""

from decimal import Decimal
from pathlib import Path
from typing import Any

from drone_env.core.actions import Event
from drone_env.core.rewards import PACKAGE_PROFILES, RewardProfile, get_reward_profile
from drone_env.errors import InvalidTaskError, InvalidValueError, shown
from drone_env.files import read_file
from drone_env.toml_text import parse_toml

MAX_FILE = 1 << 16
KEYS: dict[str, tuple[type, ...]] = {
    "id": (str,),
    "summary": (str,),
    "task_events": (bool,),
    "events": (dict,),
    "shaping": (Decimal, int),
    "clamp": (list,),
    "shaping_gamma": (Decimal, int),
    "pays_score": (bool,),
}
EVENTS = {event.name.lower(): event for event in Event if event is not Event.NONE}


def chosen_profile(name: str | RewardProfile) -> RewardProfile:
    """The reward profile of this name, or of the TOML file of this name; a `RewardProfile` is handed back as it is.

    Raises:
        UnknownNameError: if it does not end in `.toml` and there is no such profile.
        OSError: if the file cannot be read.
        InvalidTaskError: if the file is not a reward profile; the message says why.
    """
    if isinstance(name, str) and name.endswith(".toml"):
        return load_reward_profile(name)
    return get_reward_profile(name)


def load_reward_profile(path: str | Path) -> RewardProfile:
    """The reward profile in a TOML file; numbers are kept as the decimals that they are written as.

    Raises:
        OSError: if the file cannot be read.
        InvalidTaskError: if it is not a reward profile; the message says why.
    """
    path = Path(path)

    def require(holds: bool, message: str) -> None:
        if not holds:
            raise InvalidTaskError(f"reward profile {path}: {message}")

    try:
        content = read_file(path, MAX_FILE)
    except InvalidValueError as error:
        raise InvalidTaskError(f"reward profile {error}") from None
    try:
        table = parse_toml(content, parse_float=Decimal)
    except InvalidValueError as error:
        raise InvalidTaskError(f"reward profile {path}: {error}") from None
    for key, value in table.items():
        require(key in KEYS, f"unknown key {shown(key)}; allowed: {', '.join(KEYS)}")
        fits = isinstance(value, KEYS[key]) and (bool in KEYS[key] or not isinstance(value, bool))
        require(fits, f"{key} must be {_named(KEYS[key])}, got {shown(value)}")
    require(bool(table.get("id")), "id is missing")
    require(table["id"].isprintable(), f"id must be printable, got {shown(table['id'])}")
    require(table["id"] not in PACKAGE_PROFILES, f"id {shown(table['id'])} is taken by a profile of the package")
    events: dict[str, Any] = table.pop("events", {})
    for name, value in events.items():
        require(name in EVENTS, f"unknown event {shown(name)}; allowed: {', '.join(EVENTS)}")
        require(_is_number(value), f"events.{name} must be a number, got {shown(value)}")
    clamp: list[Any] | None = table.pop("clamp", None)
    require(clamp is None or (len(clamp) == 2 and all(map(_is_number, clamp))), "clamp must be [lowest, highest]")
    numbers = {key: Decimal(table.pop(key)) for key in ("shaping", "shaping_gamma") if key in table}
    fields: dict[str, Any] = {"summary": "", **table, **numbers}
    return RewardProfile(
        **fields,
        events=tuple((EVENTS[name], Decimal(value)) for name, value in events.items()),
        clamp=None if clamp is None else (Decimal(clamp[0]), Decimal(clamp[1])),
    )


def _is_number(value: object) -> bool:
    return isinstance(value, (Decimal, int)) and not isinstance(value, bool)


def _named(types: tuple[type, ...]) -> str:
    names = {str: "a text", bool: "true or false", dict: "a table", Decimal: "a number", list: "a list"}
    return names[types[0]]
