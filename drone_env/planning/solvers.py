"""Which solver values the decisions of a map: the fastest that covers its task. Importing this loads Numba."""

from drone_env.core.episode import Episode
from drone_env.planning.exact import ExactSolver
from drone_env.planning.legs import LegSolver, covers
from drone_env.planning.solver import Solver


def solver_of(episode: Episode) -> Solver:
    """The values of everything that can still become of an episode in flight, which is left as it is.

    Raises:
        EpisodeError: if it has not begun, or has ended.
        TooLargeError: if that would take more memory than `map_graph.MAX_BYTES`.
    """
    return LegSolver(episode) if covers(episode.task) else ExactSolver(episode)
