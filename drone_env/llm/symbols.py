"""What prompts call actions and kinds of cells: plain names, or ones that are drawn for each map.

Drawn names help a model nothing that knows UP and buildings by heart: it has to go by what the prompt says of them.
"""

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

from drone_env.core.actions import ACTION_OFFSETS, Action
from drone_env.core.seeds import map_key, next_key, task_key, uniform_below
from drone_env.core.tasks import TaskConfig
from drone_env.models import NAMES

FIRST = "BLO BRI CRA DRU FLU FRE GLA GRU KLE KRI PLE PRU SKO SNU STU TRU VLA ZWE"
SECOND = "BA DO FI GU LU MI NA PU SA TI VO ZA"
"""Syllables: a word is one of each, and no two of a map begin alike. None of them means anything."""
KINDS = ("parcel", "road", "building", "tree", "obstacle", "pad")
"""What stands on a map and has a name; the drone is the one thing that is always called so."""
PLAIN_LETTERS = dict(zip(NAMES, ".BTOPxD?C", strict=True))
DRAWN_LETTERS = "AEFGHJKLMNQRSUVWYZ"
"""All but those that stand for something in plain grids."""
WORDS = re.compile(
    r"\b(UP|DOWN|LEFT|RIGHT|WAIT)\b|(?i:\b(an? )?(parcel|road|building|tree|obstacle|(?:charging )?pad)(s?)\b)"
)


class Symbols(NamedTuple):
    """What is called how.

    Attributes:
        names: Of each action and kind of cell that is called otherwise than plainly, the drawn one.
        letters: What stands in the grid as text, by kind of cell.
        actions: The words that an answer may hold, in capitals.
    """

    names: Mapping[str, str]
    letters: Mapping[str, str]
    actions: Mapping[str, Action]

    @property
    def legend(self) -> str:
        """What the letters of the grid mean."""
        of = self.letters
        return (
            f"{of['drone']} is the drone, {of['delivery']} a parcel to deliver, {of['delivered']} a delivered one, "
            f"{of['road']} road, {of['building']} building, {of['tree']} tree, {of['obstacle']} obstacle, "
            f"{of['pad']} charging pad."
        )

    @property
    def meaning(self) -> str:
        """What the drawn words mean, as far as no rule says it; nothing where none are drawn."""
        if not self.names:
            return ""
        moves = [f"{self.names[action.name]} {_move(action)}" for action in Action]
        return (
            f"The words for actions and cells are drawn for this map alone: {', '.join(moves)}; "
            f"a cell on which nothing stands is {self.names['road']}."
        )

    def called(self, text: str) -> str:
        """A text in plain words, in these words."""
        return WORDS.sub(self._called, text) if self.names else text

    def _called(self, found: re.Match[str]) -> str:
        action, article, kind, plural = found.groups()
        if action:
            return self.names[action]
        name = self.names[kind.lower().removeprefix("charging ")]
        # All of them begin with a consonant.
        before = f"{article[0]} " if article else ""
        return f"{before}{name.capitalize() if kind[0].isupper() else name}{plural}"


PLAIN = Symbols({}, PLAIN_LETTERS, Action.__members__)


@lru_cache(maxsize=256)
def draw_symbols(task: TaskConfig, seed: int) -> Symbols:
    """The names that are drawn for a map: always the same, and by other random numbers than the map itself."""
    key = map_key(task_key(f"{task.id}/symbols", task.version), seed)

    def draw(n: int) -> int:
        nonlocal key
        key = next_key(key)
        return uniform_below(key, n)

    first, second, letters = FIRST.split(), SECOND.split(), list(DRAWN_LETTERS)
    words = {name: first.pop(draw(len(first))) + second[draw(len(second))] for name in (*Action.__members__, *KINDS)}
    return Symbols(
        names={name: word if name in Action.__members__ else word.lower() for name, word in words.items()},
        letters={name: "?" if name == "unknown" else letters.pop(draw(len(letters))) for name in NAMES},
        actions={words[name]: action for name, action in Action.__members__.items()},
    )


def _move(action: Action) -> str:
    dx, dy = ACTION_OFFSETS[action]
    axis, way = ("x", dx) if dx else ("y", dy)
    return "waits" if action is Action.WAIT else f"is {axis} {'+' if way > 0 else '-'} 1"
