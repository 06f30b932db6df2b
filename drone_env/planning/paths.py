"""Ways between cells where nothing blocks and every step costs the same."""

from drone_env.core.actions import Action

Position = tuple[int, int]


def distance(a: Position, b: Position) -> int:
    """Steps from one position to another."""
    return abs(a[0] - b[0]) + abs(a[1] - b[1])


def route(a: Position, b: Position) -> list[Action]:
    """All actions of a shortest way: along the row first."""
    sideways = [Action.RIGHT if b[0] > a[0] else Action.LEFT] * abs(b[0] - a[0])
    return sideways + [Action.DOWN if b[1] > a[1] else Action.UP] * abs(b[1] - a[1])
