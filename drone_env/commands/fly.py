"""`drone-env fly`: one mission, as log lines."""

import sys
from pathlib import Path

from drone_env.agents import make_agent
from drone_env.commands.arguments import AgentName, ProfileName, Seed, TaskName
from drone_env.core.state_manager import Episode
from drone_env.envs.ansi import draw_text
from drone_env.envs.rendering import save_picture
from drone_env.episodes.log_lines import end_line, start_line, step_line
from drone_env.errors import InvalidValueError
from drone_env.planning.optimal import best_of


def fly(
    task: TaskName = "easy",
    agent: AgentName = "greedy",
    seed: Seed = None,
    reward_profile: ProfileName = "tiered",
    render: bool = False,
    picture: Path | None = None,
) -> None:
    """Fly one mission and print its log lines.

    Standard output holds one [START] line, one [STEP] line per step and one [END] line, and nothing else; maps,
    pictures' paths and the comparison with the optimum go to standard error.

    Example: drone-env fly --task hard --agent greedy --seed 7 --render

    Args:
        task: The task, by its short name, id or grader.
        agent: Who flies.
        seed: Number of the map, 0 to 2^53 - 1. Without one, a train map is drawn at random and its number is told.
        reward_profile: What steps pay.
        render: Show the map after every step.
        picture: Save a picture of the flight to this PNG file at the end.
    """
    episode = Episode(task, reward_profile)
    pilot = make_agent(agent, task)
    if picture is not None:
        if picture.suffix != ".png":
            raise InvalidValueError(f"--picture takes a file that ends in .png, got {picture}")
        picture.parent.mkdir(parents=True, exist_ok=True)
    pilot.reset(episode.reset(seed))
    if render:
        print(draw_text(episode), file=sys.stderr)
    print(start_line(episode.task, agent))
    while not episode.ended:
        reward = episode.step(pilot.act(episode.observation()))
        print(step_line(episode.steps, episode.path[-1].action, reward, episode.ended), flush=render)
        if render:
            print(draw_text(episode), file=sys.stderr)
    print(end_line(episode.success, episode.score, [point.reward for point in episode.path]))
    optimum = best_of(episode.task, episode.seed)
    known = f"the optimum is {optimum.score:.4f} in {optimum.steps}" if optimum else "the optimum is not known"
    print(f"map {episode.seed}: {agent} scored {episode.score:.4f} in {episode.steps} steps; {known}", file=sys.stderr)
    if picture is not None:
        save_picture(episode, picture)
        print(f"picture: {picture}", file=sys.stderr)
