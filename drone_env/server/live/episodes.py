"""One episode that a page flies: a session, its pilot, and how far the page has seen it."""

from contextlib import suppress
from typing import TYPE_CHECKING

from typing_extensions import Self

from drone_env.agents.pathqnet import PathQNetAgent
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.episodes.sessions import SessionRow
from drone_env.errors import EpisodeError, NoSessionError, SessionGoneError
from drone_env.models import Direction
from drone_env.server.frames import Frame, Opening, ShownEpisode, frame_of
from drone_env.server.pilots import HUMAN, PILOTS, agent_of
from drone_env.server.state import Shared

if TYPE_CHECKING:
    from drone_env.planning.solver import Solver


class LiveEpisode:
    """An episode that a page flies. The row of its session is the truth; this follows it.

    Args:
        row: The session as it stands.
        shared: The parts of the server.

    Raises:
        SessionGoneError: if it flies a task that is withdrawn.
        EpisodeError: if none of our pilots flies it.
        UnsupportedTaskError: if there is no network that its pilot needs.
        CheckpointError: if that cannot be read.
    """

    def __init__(self, row: SessionRow, shared: Shared) -> None:
        if row.agent not in PILOTS:
            raise EpisodeError(f"this session is flown by {row.agent!r}, not from the page")
        self.session = row.id
        self.pilot = row.agent
        self.episode_id = row.episode_id
        self.episode = row.begin()
        self._sessions = shared.sessions
        self._values = shared.values
        self._optimum: float | None = None
        self._agent = agent_of(self.pilot, self.episode.task, shared.networks)
        if self._agent is not None:
            self._agent.reset(row.seed)
        own = self._agent if isinstance(self._agent, PathQNetAgent) else None
        self._network = own or shared.networks.beside(self.pilot, self.episode.task)
        self._observation = self.episode.observation()
        self._decision: int | None = None
        """The pilot's next action: each state is put to it once, since some draw lots."""

    @classmethod
    def attach(cls, session: str, shared: Shared) -> tuple[Self, ShownEpisode]:
        """The episode of a session, and all of it so far.

        Raises:
            NoSessionError: if there never was such a session.
            SessionGoneError: if it has ended or expired, or flies a task that is withdrawn.
            EpisodeError: if none of our pilots flies it.
            UnsupportedTaskError: if there is no network that its pilot needs.
            CheckpointError: if that cannot be read.
        """
        row = shared.store.read_session(session)
        live = cls(row, shared)
        opening = Opening.of(live.episode, live.pilot, session)
        return live, ShownEpisode(opening=opening, frames=[live._look(), *live._follow(row)])

    @property
    def automatic(self) -> bool:
        """Whether it flies by itself, and has not ended."""
        return self._agent is not None and not self.episode.ended

    def step(self) -> list[Frame]:
        """Let the pilot of an automatic episode fly one step; the frames that follow from it."""
        return self._fly(self._decide())

    def fly(self, direction: Direction) -> list[Frame]:
        """Fly one step by hand.

        Raises:
            EpisodeError: if an agent flies this episode, or it has ended.
        """
        if self.pilot != HUMAN:
            raise EpisodeError(f"{self.pilot} flies this episode: start one with the pilot {HUMAN!r} to fly yourself")
        if self.episode.ended:
            raise EpisodeError("this episode has ended: start another")
        return self._fly(Action[direction])

    def reachable(self) -> list[float] | None:
        """The best score that could still be reached at each frame so far; None while it is unknown or kept back."""
        solver = self._solver()
        if solver is None:
            return None
        flight = self._at_start()
        values = [solver.value(flight)]
        for action in self.episode.actions:
            flight.step(action)
            values.append(solver.value(flight))
        return values

    def end(self) -> None:
        """Give the session back.

        Raises:
            StoreError: if the store could not be written.
        """
        with suppress(NoSessionError, SessionGoneError):  # it may have been idle for too long
            self._sessions.end(self.session)

    def _decide(self) -> int:
        if self._decision is None:
            assert self._agent is not None
            self._decision = int(self._agent.act(self._observation))
        return self._decision

    def _fly(self, action: int) -> list[Frame]:
        flown = self.episode.copy()  # where the step cannot be kept, nothing has changed here
        with self._sessions.store.session(self.session) as row:
            if row.agent != self.pilot or not row.follows(flown):
                raise SessionGoneError("this session flies another episode by now: start a new one")
            # Another page may have gone on with the same session: then this one catches up.
            alone = len(row.actions) == flown.steps
            if alone:
                row.step(flown, action)
        self.episode_id = row.episode_id
        if not alone:
            return self._follow(row)
        self.episode = flown
        return [self._look()]

    def _follow(self, row: SessionRow) -> list[Frame]:
        """Fly what the session has flown and this has not, and return the frames of it."""
        frames: list[Frame] = []
        for action in row.actions[self.episode.steps :]:
            if self._agent is not None:
                self._decide()
            self.episode.step(action)
            frames.append(self._look())
        return frames

    def _look(self) -> Frame:
        """The frame of the episode as it stands: its map is drawn once, and a network asked once."""
        self._observation = self.episode.observation()
        value = None
        solver = self._solver()
        if solver is not None:
            value = solver.value(self.episode)
            if self._optimum is None:
                self._optimum = solver.value(self._at_start())
        frame = frame_of(self.episode, self._observation, self._network, value, self._optimum)
        own = frame.q_values if self._agent is self._network else None
        self._decision = Action[max(own, key=own.__getitem__)] if own else None
        return frame

    def _solver(self) -> "Solver | None":
        """The solver of the map; None while there is none, and for a person in flight: values would show good moves."""
        shown = self.pilot != HUMAN or self.episode.ended
        return self._values.get(self.episode.task, self.episode.seed) if shown else None

    def _at_start(self) -> Episode:
        return Episode(self.episode.task, self.episode.reward_profile, self.episode.seed)
