"""Links to the page: which flight a query names, and the preview that sites show of it."""

from itertools import islice
from urllib.parse import urlencode

from pydantic import BaseModel, ConfigDict, Field

from drone_env.core.episode import Episode, choices
from drone_env.core.rewards import ORIGINAL_PROFILE
from drone_env.core.tasks import MAX_UNITS, get_task
from drone_env.errors import InvalidValueError, UnknownNameError
from drone_env.models import Seed
from drone_env.planning.optimal import best_of
from drone_env.results.record import EpisodeRecord, replay_steps
from drone_env.server.jobs import job_context
from drone_env.server.map_choice import DEFAULT_TASK
from drone_env.server.pilots import HUMAN, agent_of, all_pilots, display_name
from drone_env.server.state import LONGEST_ID


class Link(BaseModel):
    """The query of a link to the page. Unknown parameters are ignored: sites add their own, the page reads more."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    task: str = Field(default=DEFAULT_TASK, max_length=100, description="Id or short name of the task.")
    seed: Seed | None = Field(default=None, description="Number of the map.")
    pilot: str = Field(default="", max_length=100, description="Id of the pilot.")
    pilots: str | None = Field(default=None, max_length=400, description="Pilots of a race, separated by commas.")
    profile: str = Field(default=ORIGINAL_PROFILE, max_length=100, description="Id of the reward profile.")
    step: int | None = Field(default=None, ge=0, le=MAX_UNITS, description="The step to show; the last by default.")
    episode: str | None = Field(
        default=None, max_length=LONGEST_ID, description="Id of a stored episode; replaces task, seed and pilots."
    )

    @property
    def first_pilot(self) -> str:
        """Id of the first pilot; empty if the link names none."""
        return (self.pilot if self.pilots is None else self.pilots).partition(",")[0]

    def start(self) -> Episode:
        """The map of the link, with the drone at its start.

        Raises:
            UnknownNameError: if the task, the pilot or the reward profile does not exist.
            InvalidValueError: if the link names no map.
        """
        task = get_task(self.task)
        if self.seed is None:
            raise InvalidValueError("the link names no map: it requires task=hard&seed=7, or episode=ID")
        if self.first_pilot and self.first_pilot not in all_pilots():
            raise UnknownNameError("pilot", self.first_pilot, all_pilots())
        return Episode(task, self.profile, self.seed)

    def query(self) -> str:
        """The query string, without the ignored parameters."""
        return urlencode(self.model_dump(exclude_defaults=True), safe=",")

    def title(self, record: EpisodeRecord | None) -> str:
        """The map and its first pilot in one line.

        Args:
            record: The stored episode that the link names, None without one.

        Raises:
            UnknownNameError, InvalidValueError: as `start`.
        """
        if record is not None:
            return self._title(display_name(record.agent), record.task, record.seed)
        start, pilot = self.start(), self.first_pilot
        name = "Fly it yourself" if pilot == HUMAN else all_pilots()[pilot].name if pilot else ""
        return self._title(name, start.task.id, start.seed)

    def _title(self, name: str, task: str, seed: int) -> str:
        title = f"{get_task(task).short_name.replace('_', ' ').title()}, map {seed}"
        title = f"{name}: {title}" if name else title
        return title if self.step is None else f"{title}, step {self.step}"


FIRST_PAINT = Link(task="skyline_medium", seed=43, pilot="tournet")
"""The flight that the page shows before its scripts run; `tools/first_paint.py` draws it."""


def draw_preview(link: Link, record: EpisodeRecord | None) -> bytes:
    """The picture of a link, 1200 by 630 pixels, as a PNG: the map with the flight of its first pilot up to its step.

    Args:
        link: The link.
        record: The stored episode that the link names, None without one.

    Raises:
        UnknownNameError, InvalidValueError: as `Link.start`.
        UnsupportedTaskError: if the pilot cannot fly the task.
        CheckpointError: if its network cannot be read.
        TooLargeError: if the map is too large for the pilot.
    """
    from drone_env.envs.rendering import draw_card  # Imported lazily: the serving process does without Pillow.

    if record is not None:
        *_, episode = islice(replay_steps(record), None if link.step is None else link.step + 1)
        name = display_name(record.agent)
    else:
        episode, pilot = link.start(), link.first_pilot
        agent = agent_of(pilot, episode.task, job_context().networks) if pilot else None
        if agent is not None:
            agent.reset(episode.seed)
            episode.fly(islice(choices(episode, agent.act), link.step))
        name = all_pilots()[pilot].name if pilot else ""
    return draw_card(episode, _lines(name, episode))


def _lines(name: str, episode: Episode) -> list[tuple[str, bool]]:
    if not name:
        return []
    if not episode.ended:
        return [(name, True), (f"step {episode.steps}" if episode.steps else "at the start", False)]
    best = best_of(episode.task, episode.seed)
    optimum = [] if best is None else [("", False), (f"optimum {100 * best.score:.1f}", False)]
    return [(name, True), (f"score {100 * episode.score:.1f}", False), *optimum]
