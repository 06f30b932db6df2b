"""One episode that a page flies: a session, its pilot, and how far the page has seen it."""

from collections.abc import Iterable
from contextlib import suppress
from hashlib import sha256
from typing import TYPE_CHECKING

from typing_extensions import Self

from drone_env.agents.pathqnet import PathQNetAgent
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.episodes.finished import check_agent
from drone_env.episodes.record import record_of
from drone_env.episodes.sessions import SessionRow
from drone_env.errors import EpisodeError, NoSessionError, SessionGoneError
from drone_env.models import Direction
from drone_env.server.frames import Frame, Opening, ShownEpisode, frame_of
from drone_env.server.pilots import HUMAN, PILOTS, Credit, agent_of
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
        self.by, self.credit = row.agent, Credit.parse(row.agent)
        self.pilot = self.credit.pilot
        if self.pilot not in PILOTS:
            raise EpisodeError(f"this session is flown by {row.agent!r}, not from the page")
        self.session = row.id
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
        opening = Opening.of(live.episode, row.agent, session)
        return live, ShownEpisode(opening=opening, frames=[live._look(), *live._follow(row.actions)])

    @property
    def automatic(self) -> bool:
        """Whether it flies by itself, and has not ended."""
        return self._agent is not None and not self.episode.ended

    @property
    def first(self) -> int:
        """The steps that others have flown, before the pilot began."""
        return self.credit.forked_at or 0

    def step(self) -> list[Frame]:
        """Let the pilot of an automatic episode fly one step; the frames that follow from it."""
        return self._fly(self._decide())

    def begin_after(self, actions: Iterable[Direction]) -> list[Frame]:
        """Fly what a fork has behind it when it is started, and return the frames of it.

        Raises:
            EpisodeError: if an agent is said to have flown what it would not fly.
        """
        frames = self._follow([Action[direction] for direction in actions], check=True)
        self._keep_beginning()
        return frames

    def begin_at(self, steps: int) -> list[Frame]:
        """Let the pilot fly so many steps, or to the end, when it is started, and return the frames of them."""
        frames: list[Frame] = []
        while self.automatic and self.episode.steps < steps:
            frames += self._follow([self._decide()])
        if frames:
            self._keep_beginning()
        return frames

    def _keep_beginning(self) -> None:
        with self._sessions.store.session(self.session) as row:
            for action in self.episode.actions:
                row.append(action)
            if self.episode.ended:
                # Named by what it is: however often a link to it is opened, it is kept once.
                record = record_of(self.episode, row.agent).to_json()
                self.episode_id = row.finish(self.episode, sha256(record.encode()).hexdigest()[:16])

    def fly(self, direction: Direction) -> list[Frame]:
        """Fly one step by hand.

        Raises:
            EpisodeError: if an agent flies this episode, or it has ended.
        """
        self._check_by_hand()
        return self._fly(Action[direction])

    def undo(self) -> list[Frame]:
        """Take back the last step flown by hand, and say so of who flew.

        Returns:
            None but where another page has flown on meanwhile: the frames of that, with nothing taken back.

        Raises:
            EpisodeError: if an agent flies this episode, it has ended, or the person has flown nothing yet.
        """
        self._check_by_hand()
        if self.episode.steps <= self.first:
            since = f"since step {self.first}, where the fork begins" if self.first else "yet"
            raise EpisodeError(f"there is nothing to take back: you have not flown {since}")
        before = self._at_start().fly(self.episode.actions[:-1])
        with self._sessions.store.session(self.session) as row:
            self._recognise(row, self.episode)
            alone = len(row.actions) == self.episode.steps
            if alone:
                row.undo()
                row.agent = check_agent(str(self.credit._replace(undo=True)))
        self.by, self.credit = row.agent, Credit.parse(row.agent)
        if not alone:
            return self._follow(row.actions[self.episode.steps :])
        self.episode = before
        return []

    def help(self) -> Frame:
        """Show a person in flight what the actions are worth from now on, and say so of who flew; the frame with that.

        Raises:
            EpisodeError: if an agent flies this episode, or it has ended.
        """
        self._check_by_hand()
        with self._sessions.store.session(self.session) as row:
            self._recognise(row, self.episode)
            row.agent = check_agent(str(self.credit._replace(values=True)))
        self.by, self.credit = row.agent, Credit.parse(row.agent)
        return self._look()

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
            self._recognise(row, flown)
            # Another page may have gone on with the same session: then this one catches up.
            alone = len(row.actions) == flown.steps
            if alone:
                row.step(flown, action)
        self.episode_id = row.episode_id
        if not alone:
            return self._follow(row.actions[self.episode.steps :])
        self.episode = flown
        return [self._look()]

    def _recognise(self, row: SessionRow, flown: Episode) -> None:
        """See whether the session still flies this episode. Another page may have asked for help with it meanwhile."""
        credit = self.credit if row.agent == self.by else Credit.parse(row.agent)
        same = self.credit._replace(values=credit.values, undo=credit.undo)
        if credit != same or not row.follows(flown):
            raise SessionGoneError("this session flies another episode by now: start a new one")
        self.by, self.credit = row.agent, credit

    def _check_by_hand(self) -> None:
        if self.pilot != HUMAN:
            raise EpisodeError(f"{self.pilot} flies this episode: start one with the pilot {HUMAN!r} to fly yourself")
        if self.episode.ended:
            raise EpisodeError("this episode has ended: start another")

    def _follow(self, actions: Iterable[int], *, check: bool = False) -> list[Frame]:
        """Fly what has been flown already, and return the frames; `check` refuses what the agent would not fly."""
        frames: list[Frame] = []
        for action in actions:
            # Where others flew it was not asked, and some plan anew each time.
            own = self._agent is not None and self.episode.steps >= self.first
            if own and self._decide() != action and check:
                step, flies = self.episode.steps + 1, Action(self._decide()).name
                raise EpisodeError(
                    f"step {step} of the fork is said to be flown by {self.pilot}, which flies {flies} there"
                )
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
        network = self._network if self._shown else None
        frame = frame_of(self.episode, self._observation, network, value, self._optimum)
        own = frame.q_values if self._agent is self._network else None
        self._decision = Action[max(own, key=own.__getitem__)] if own else None
        return frame

    @property
    def _shown(self) -> bool:
        """Whether values are shown: they are kept from a person in flight who has not asked for them."""
        return self.pilot != HUMAN or self.credit.values or self.episode.ended

    def _solver(self) -> "Solver | None":
        """The solver of the map; None while there is none, or it is kept back."""
        return self._values.get(self.episode.task, self.episode.seed) if self._shown else None

    def _at_start(self) -> Episode:
        return Episode(self.episode.task, self.episode.reward_profile, self.episode.seed)
