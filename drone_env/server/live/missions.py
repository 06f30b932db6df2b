"""One mission: a session, the pilot that flies it, and how far its page has seen it."""

from contextlib import suppress
from typing import TYPE_CHECKING

from drone_env.agents.base import Agent
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.episodes.sessions import SessionRow
from drone_env.errors import EpisodeError, NoSessionError, SessionGoneError
from drone_env.models import Direction
from drone_env.server.frames import Frame, Mission, frame_of, frames_of
from drone_env.server.live.values import ExactValues
from drone_env.server.pilots import HUMAN, PILOTS, agent_of
from drone_env.server.predict import Networks
from drone_env.server.sessions import Sessions, fly

if TYPE_CHECKING:
    from drone_env.planning.exact import ExactSolver


class LiveMission:
    """A session that the page flies. The row of the session is the truth; this follows it.

    Args:
        session: The session.
        sessions: All of them.
        networks: The trained networks.
        values: What can still be reached.

    Raises:
        NoSessionError: if there never was such a session.
        SessionGoneError: if it has ended or expired, or flies what is withdrawn.
        EpisodeError: if none of our pilots flies it.
        UnsupportedTaskError: if there is no network that its pilot needs.
        CheckpointError: if that cannot be read.
    """

    def __init__(self, session: str, sessions: Sessions, networks: Networks, values: ExactValues) -> None:
        self.session = session
        self._sessions = sessions
        self._networks = networks
        self._values = values
        row = sessions.store.read_session(session)
        if row.agent not in PILOTS:
            raise EpisodeError(f"this session is flown by {row.agent!r}, not from the page")
        self.pilot = row.agent
        self._map = _map_of(row)
        self.episode_id = row.episode_id
        self.episode = row.begin()
        self.opening = Mission.of(self.episode, row.agent, session)
        self._agent: Agent | None = agent_of(row.agent, self.episode.task, networks)
        if self._agent is not None:
            self._agent.reset(row.seed)
        self._decision: int | None = None
        self._follow(row, show=False)

    @property
    def automatic(self) -> bool:
        """Whether it flies by itself, and has not ended."""
        return self._agent is not None and not self.episode.ended

    def frames(self) -> list[Frame]:
        """All frames so far."""
        episode = Episode(self.episode.task, self.episode.reward_profile)
        episode.reset(self.episode.seed)
        values = self.reachable()
        frames = list(frames_of(episode, self.episode.actions, self._networks, self.pilot))
        if values is None:
            return frames
        return [self._with_value(frame, value, values[0]) for frame, value in zip(frames, values, strict=True)]

    def step(self) -> list[Frame]:
        """Let the pilot fly one step; the frames that follow from it."""
        return self._fly(self._decide()) if self.automatic else []

    def fly(self, direction: Direction) -> list[Frame]:
        """Fly one step by hand.

        Raises:
            EpisodeError: if an agent flies this mission, or it has ended.
        """
        if self.pilot != HUMAN:
            raise EpisodeError(f"{self.pilot} flies this mission: start one with the pilot {HUMAN!r} to fly yourself")
        if self.episode.ended:
            raise EpisodeError("this mission has ended: start another")
        return self._fly(Action[direction])

    def reachable(self) -> list[float] | None:
        """What could still be reached at each frame so far; None while that is not known, or not to be told.

        Whoever flies by hand is told after the end: before, it would tell which moves are good.
        """
        solver = self._solver()
        if solver is None:
            return None
        flight = Episode(self.episode.task, self.episode.reward_profile)
        flight.reset(self.episode.seed)
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
        """The action of the pilot here; asked once for each step, since some draw lots."""
        assert self._agent is not None
        if self._decision is None:
            self._decision = int(self._agent.act(self.episode.observation()))
        return self._decision

    def _fly(self, action: int) -> list[Frame]:
        with self._sessions.stepping(self.session) as (row, episode):
            # Another page may have gone on with the same session: then this one catches up, or is told that it is gone.
            if _map_of(row) == self._map and row.actions == tuple(self.episode.actions):
                fly(row, episode, action)
        self.episode_id = row.episode_id
        return self._follow(row)

    def _follow(self, row: SessionRow, show: bool = True) -> list[Frame]:
        """Fly what the session has flown and this has not, and return the frames of it.

        Raises:
            SessionGoneError: if the session flies something else by now.
        """
        flown = self.episode.actions
        if _map_of(row) != self._map or list(row.actions[: len(flown)]) != flown:
            raise SessionGoneError("this session flies another mission by now: start a new one")
        frames: list[Frame] = []
        for action in row.actions[len(flown) :]:
            if self._agent is not None:
                self._decide()
            self.episode.step(action)
            self._decision = None
            if show:
                frames.append(self._frame())
        return frames

    def _solver(self) -> "ExactSolver | None":
        """What knows the values; None while it does not, or they are not to be told."""
        told = self.pilot != HUMAN or self.episode.ended
        return self._values.get(self.episode.task, self.episode.seed) if told else None

    def _frame(self) -> Frame:
        frame = frame_of(self.episode, self._networks, self.pilot)
        solver = self._solver()
        if solver is None:
            return frame
        start = Episode(self.episode.task)
        start.reset(self.episode.seed)
        return self._with_value(frame, solver.value(self.episode), solver.value(start))

    @staticmethod
    def _with_value(frame: Frame, value: float, optimum: float) -> Frame:
        return frame.model_copy(update={"value": value, "regret": optimum - value})


def _map_of(row: SessionRow) -> tuple[str, int, int, str, str]:
    return row.task, row.task_version, row.seed, row.reward_profile, row.agent
