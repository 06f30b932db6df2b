"""`drone-env fly`: one flight, as log lines."""

import sys

from drone_env.agents import make_agent
from drone_env.agents.base import begin
from drone_env.commands.arguments import AgentName, OptionalPath, ProfileName, Seed, TaskName
from drone_env.commands.flights import log_flight, prepare_file
from drone_env.core.episode import Episode, choices
from drone_env.core.rewards import ORIGINAL_PROFILE
from drone_env.errors import InvalidValueError


def fly(
    task: TaskName = "easy",
    agent: AgentName = "greedy",
    seed: Seed = None,
    reward_profile: ProfileName = ORIGINAL_PROFILE,
    render: bool = False,
    picture: OptionalPath = None,
    record: OptionalPath = None,
) -> None:
    """Fly one map and print its log lines.

    Standard output contains one [START] line, one [STEP] line per step and one [END] line. Everything else goes to
    standard error.

    Example: drone-env fly --task hard --agent greedy --seed 7 --render

    Args:
        task: The task, by its short name, id or grader.
        agent: The agent that flies.
        seed: Number of the map, 0 to 2^53 - 1; by default a random train map.
        reward_profile: A reward profile, or a TOML file with one.
        render: Show the map after every step.
        picture: Save a picture of the flight to this PNG file.
        record: Save the flight to this JSON file, for `replay` and the page, or append it to this .jsonl file.
    """
    episode = Episode(task, reward_profile)
    pilot = make_agent(agent, task)
    if picture is not None:
        if picture.suffix != ".png":
            raise InvalidValueError(f"--picture takes a file that ends in .png, got {picture}")
        prepare_file("--picture", picture)
    if record is not None:
        prepare_file("--record", record)
    episode.reset(seed)
    log_flight(episode, agent, choices(episode, begin(pilot, agent, episode)), render)
    if picture is not None:
        from drone_env.envs.rendering import save_picture  # loads Pillow

        save_picture(episode, picture)
        print(f"picture: {picture}", file=sys.stderr)
    if record is not None:
        # Loads Pydantic, which only a record needs.
        from drone_env.flights.record import record_of, save_record

        save_record(record_of(episode, agent), record)
        print(f"record: {record}", file=sys.stderr)
