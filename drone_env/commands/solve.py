"""`drone-env solve`: an optimal flight over a map."""

from drone_env.commands.arguments import Seed, TaskName
from drone_env.core.episode import Episode
from drone_env.envs.ansi import draw_text, draw_tour
from drone_env.planning.optimal import solve_episode


def solve(task: TaskName = "easy", seed: Seed = None) -> None:
    """Show a map, an optimal flight over it and its score.

    Example: drone-env solve --task hard --seed 7

    Args:
        task: The task, by short name, id or grader.
        seed: Number of the map, 0 to 2^53 - 1. Default: a random train map.
    """
    episode = Episode(task)
    episode.reset(seed)
    solution = solve_episode(episode)
    path = [(step.x, step.y) for step in episode.copy().fly(solution.actions).path]
    print(draw_text(episode))
    print()
    print(draw_tour(episode, path, solution.order))
    print(f"Best score: {solution.score:.4f} with {solution.deliveries} of {episode.task.deliveries} delivered")
    print(f"Steps: {solution.steps}")
    print(f"Order: {' -> '.join(str(stop) for stop in (episode.position, *solution.order))}")
    print(f"Actions: {' '.join(action.name for action in solution.actions)}")
