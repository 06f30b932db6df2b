"""A flight by text: messages out, answers in. No other policy ever acts for the model."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, cast

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.rewards import DEFAULT_PROFILE, RewardProfile
from drone_env.core.tasks import TaskConfig
from drone_env.envs.ansi import end_line, start_line, step_line
from drone_env.errors import EpisodeError, InvalidValueError
from drone_env.llm.answers import Answer, ChatMessage, Reading, TurnKind, actions_named, read_answer, way_to
from drone_env.llm.prompt import Prompt, below_text, get_prompt, stops_text, ways_of
from drone_env.llm.sender import NO_CHANGES, Changes, changed

if TYPE_CHECKING:
    from drone_env.llm.transcript import Call

Status = Literal["finished", "errored", "budget_stop"]


class TextEpisode:
    """An episode that a language model flies by text.

        flight = TextEpisode("easy", seed=14, prompt="coordinates")
        while flight.messages:
            flight.answer(model(flight.messages))

    An unusable answer is asked for once more. If the second answer is unusable too, the step is a WAIT and is counted.

    Args:
        task: The task, or its id, short name or grader.
        seed: The map.
        prompt: The prompt, its name (the newest version) or id, or your own TOML file.
        reward_profile: The rewards of the steps; they do not change the score.

    Attributes:
        episode: The episode in its current state.
        seed: The map.
        messages: The next request; empty at the end of the flight.
        turns: The outcome of each request for actions, in order.
        attempt: 1, or 2 if `messages` ask for a repaired answer.
        faults: The answers that stayed unusable after their repair.
        flown: The action of each step, its reward, whether it ended the episode, and why it is a WAIT that the model
            did not choose; None if the model chose it.

    Raises:
        UnknownNameError: if the task, prompt or profile does not exist.
        InvalidValueError: if the seed is out of range, or the prompt cannot be rendered.
    """

    def __init__(
        self,
        task: TaskConfig | str,
        seed: int,
        prompt: Prompt | str = "minimal",
        reward_profile: RewardProfile | str = DEFAULT_PROFILE,
    ) -> None:
        self.prompt = get_prompt(prompt) if isinstance(prompt, str) else prompt
        self.episode = Episode(task, reward_profile, seed)
        self.seed = self.episode.seed
        self.turns: list[TurnKind] = []
        self.faults: list[Reading] = []
        self.flown: list[tuple[Action, float, bool, str | None]] = []
        self.attempt: Literal[1, 2] = 1
        self._ways: dict[str, list[Action]] = {}
        self.messages: list[ChatMessage] = self._request()

    def answer(self, answer: Answer | str) -> list[ChatMessage]:
        """Fly the actions of the model's answer; returns the next `messages`, empty at the end of the flight.

        Raises:
            EpisodeError: if the flight is over.
            EndpointError: if the server did not finish the answer; ask for another one.
        """
        given = Answer(text=answer) if isinstance(answer, str) else answer
        return self.take(self.read(given))

    def read(self, answer: Answer) -> Reading:
        """Parse an answer to the next request; raises as `answer`."""
        return read_answer(answer, self.prompt.plan, self.prompt.marks, self._ways if self.prompt.stop else None)

    def take(self, reading: Reading) -> list[ChatMessage]:
        """Fly an answer that has been parsed."""
        if not self.messages:
            raise EpisodeError("the flight is over: start another TextEpisode")
        if self.attempt == 1 and not reading.actions:
            self.attempt = 2
            self.messages = [*self.messages, *self.prompt.repair_messages(reading.text, reading.reason)]
            return self.messages
        outcome: TurnKind = "repaired" if self.attempt == 2 and reading.actions else reading.kind
        self.attempt = 1
        self.turns.append(outcome)
        if not reading.actions:
            self.faults.append(reading)
        episode = self.episode
        for action in reading.actions or (Action.WAIT,):
            reward = episode.step(action)
            ended = episode.ended
            self.flown.append((action, reward, ended, None if reading.actions else outcome))
            if ended:
                break
        done = self.prompt.plan or self.flown[-1][2]
        self.messages = [] if done else self._request()
        return self.messages

    def _request(self) -> list[ChatMessage]:
        """The request in the current state; empty if the prompt asks for a stop and none is in reach."""
        if self.prompt.stop:
            self._ways = ways_of(self.episode)
            if not self._ways:
                return []
        return self.prompt.messages(self.episode)

    def fly(self, directions: object) -> str:
        """Fly a tool call instead of an answer; returns what happened, and where the drone is now.

        Args:
            directions: 1 to `max_steps` names of actions, in any letter case. Those after the end are not flown.

        Raises:
            InvalidValueError: if it is anything else; nothing is flown then.
        """
        most = self.episode.task.max_steps
        route = cast(Sequence[object], directions) if isinstance(directions, list | tuple) else ()
        if not 0 < len(route) <= most:
            raise InvalidValueError(self.prompt.repair_text(f"A route is a list of 1 to {most} directions"))
        try:
            actions = actions_named(route)
        except InvalidValueError as error:
            raise InvalidValueError(self.prompt.repair_text(str(error))) from None
        return self._flown_text(actions)

    def goto(self, stop: object) -> str:
        """Fly a tool call that names a stop; returns what happened, where the drone is, and the stops in reach.

        Raises:
            InvalidValueError: if the stop is not in reach; nothing is flown then.
        """
        told = self._flown_text(way_to(stop, ways_of(self.episode)))
        return told if self.episode.ended else f"{told}\n{stops_text(self.episode)}"

    def _flown_text(self, actions: Sequence[Action]) -> str:
        """Fly actions, up to the end; returns what happened, and where the drone is now."""
        episode, told = self.episode, dict[str, None]()
        for action in actions:
            episode.step(action)
            told[episode.message] = None
            if episode.ended:
                return " ".join(told)
        return f"{' '.join(told)} {status_text(episode)}"

    @property
    def waits(self) -> int:
        """The number of steps that are a WAIT because the answer was unusable."""
        return sum(error is not None for *_, error in self.flown)

    @property
    def score(self) -> float:
        """The graded score; before the end, the score of waiting from here on."""
        return self.episode.counted_score()

    @property
    def success(self) -> bool:
        """Whether every parcel is delivered."""
        return self.episode.success

    @property
    def regret(self) -> float | None:
        """The optimum of the map minus `score`; None if the map is too large to be solved."""
        from drone_env.planning.optimal import best_of  # Imported lazily: only finished flights need it.

        optimum = best_of(self.episode.task, self.seed)
        return None if optimum is None else optimum.score - self.score


def status_text(episode: Episode) -> str:
    """The position, battery, target and deliveries in words, as the answer to a tool call."""
    below = below_text(episode)
    return (
        f"Position: {episode.position}. Battery: {episode.battery_units} units. "
        f"Nearest parcel: {episode.target}. Delivered: {episode.deliveries_done} of {episode.task.deliveries}."
    ) + (f" {below}." if below else "")


class CallKey(NamedTuple):
    """Identifies a call of a run: flight from 0, turn from 1, attempt 1, or 2 after an unusable answer."""

    flight: int
    turn: int
    attempt: int

    def __str__(self) -> str:
        return f"{self.flight}-{self.turn}-{self.attempt}"


class EpisodeRun(TextEpisode):
    """A flight of a run. Its calls can fail.

    Attributes:
        index: Its number in the run, from 0.
        repeat: The number of earlier flights of the run over the same map.
        parameters: The fields of its requests besides the messages.
        key: The key of the last request.
        changes: What it changed, because the endpoint rejects it.
        body: Its body.
        status: `finished` also if a route ended before the episode did.
        error: Why it is not finished.
    """

    index = repeat = 0
    parameters: Mapping[str, Any]
    key: CallKey
    changes: Changes = NO_CHANGES
    body: Mapping[str, Any]
    status: Status = "finished"
    error: str | None = None

    @property
    def next_key(self) -> CallKey:
        """The key of the next call."""
        return CallKey(self.index, len(self.turns) + 1, self.attempt)

    def request(self, changes: Changes) -> Mapping[str, Any]:
        """The body of the next request.

        Args:
            changes: What it changes because the endpoint rejects it; kept in `changes`.
        """
        body = {"messages": self.messages, **self.parameters}
        self.key, self.changes, self.body = self.next_key, changes, changed(body, changes) if changes else body
        return self.body

    def replay(self, calls: "Mapping[CallKey, Call]") -> int:
        """Fly the answers of earlier calls, up to the first that is missing; returns their number.

        Args:
            calls: Those of this flight that have an answer, in the order of its turns.

        Raises:
            InvalidValueError: if a call sent another request than the flight makes.
        """
        flown = 0
        for key, call in calls.items():
            if call.answer is None or not self.messages or key != self.next_key:
                break
            call.check(self.request(call.changes))
            self.take(self.read(call.answer))
            flown += 1
        return flown

    def log_lines(self, model: str, printed: int = 0) -> list[str]:
        """The log lines of the flight so far, without the first `printed` ones.

        A step with an unusable answer shows the outcome of that answer as its error.
        """
        start, first = [] if printed else [start_line(self.episode.task, model)], max(printed - 1, 0)
        return start + [step_line(number, *step) for number, step in enumerate(self.flown[first:], first + 1)]

    @property
    def last_line(self) -> str:
        """The line of the end of the flight.

        The score of a flight that a limit stopped is that of waiting to the end; an errored flight has no score.
        """
        return end_line(self.success, None if self.status == "errored" else self.score, self.episode.rewards)

    @property
    def begun(self) -> bool:
        """Whether it is more than a flight that a limit stopped before its first answer."""
        return self.status != "budget_stop" or self.attempt == 2 or bool(self.flown)

    def stop(self, status: Literal["errored", "budget_stop"], error: str) -> None:
        """End the flight because a call has no answer."""
        self.turns.append("api_error" if status == "errored" else status)
        self.status, self.error, self.messages = status, error, []
