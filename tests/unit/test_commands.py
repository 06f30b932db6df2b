"""Commands of the page: what people read where one is refused."""

import json
from typing import Any

import pytest

from drone_env.errors import InvalidValueError
from drone_env.models import MAX_SEED
from drone_env.server.live.commands import parse_command


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"seed": -7}, f"the number of a map is a whole number from 0 to {MAX_SEED}"),
        ({"seed": "seven"}, f"the number of a map is a whole number from 0 to {MAX_SEED}"),
        ({"pilots": ["greedy"] * 5}, "pilots: at most 4 fly at once, not 5"),
        ({"fork": {"actions": [], "step": 0, "of": "human"}}, "a fork needs the seed of its map"),
        ({"colour": "red"}, "colour: Extra inputs are not permitted"),
    ],
)
def test_what_is_wrong_is_told_without_the_name_of_the_command(change: dict[str, Any], says: str) -> None:
    with pytest.raises(InvalidValueError) as refused:
        parse_command(json.dumps({"type": "start", "task": "easy", "pilots": ["greedy"], **change}).encode())
    assert str(refused.value) == says
