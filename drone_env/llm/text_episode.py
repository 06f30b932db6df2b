"""A flight by text: messages out, answers in. No other policy ever acts for the model."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, cast

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.rewards import DEFAULT_PROFILE, RewardProfile
from drone_env.core.tasks import TaskConfig
from drone_env.errors import EpisodeError, InvalidValueError
from drone_env.llm.answers import Answer, ChatMessage, Reading, TurnKind, actions_named, read_answer
from drone_env.llm.prompt import Prompt, below_text, get_prompt
from drone_env.llm.rejections import NO_CHANGES, Changes, changed
from drone_env.llm.transcript import CallKey

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
        history: Number of last steps that the prompt shows.

    Attributes:
        episode: The episode in its current state.
        seed: The map.
        messages: The next request; empty at the end of the flight.
        turns: The outcome of each request for actions, in order.
        attempt: 1, or 2 if `messages` ask for a repaired answer.
        faults: The answers that stayed unusable after their repair.
        step_errors: For each step, why it is a WAIT that the model did not choose; None if the model chose it.

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
        history: int = 0,
    ) -> None:
        self.prompt = get_prompt(prompt) if isinstance(prompt, str) else prompt
        self.episode = Episode(task, reward_profile, seed)
        self.seed = self.episode.seed
        self.turns: list[TurnKind] = []
        self.faults: list[Reading] = []
        self.step_errors: list[str | None] = []
        self.attempt: Literal[1, 2] = 1
        self._history = history
        self._steps: list[str] = []
        self.messages: list[ChatMessage] = self.prompt.messages(self.episode)

    def answer(self, answer: Answer | str) -> list[ChatMessage]:
        """Fly the actions of the model's answer; returns the next `messages`, empty at the end of the flight.

        Raises:
            EpisodeError: if the flight is over.
            EndpointError: if the server did not finish the answer; ask for another one.
        """
        return self.take(self.read(Answer(text=answer) if isinstance(answer, str) else answer))

    def read(self, answer: Answer) -> Reading:
        """The actions that an answer means in the current state: the first half of `answer`."""
        return read_answer(answer, self.prompt.plan, self.prompt.marks)

    def take(self, reading: Reading) -> list[ChatMessage]:
        """Fly an answer that has been parsed: the other half."""
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
            episode.step(action)
            self.step_errors.append(None if reading.actions else outcome)
            if self._history:
                x, y = episode.position
                self._steps.append(f"{episode.steps}. {action.name} -> ({x}, {y}). {episode.message}")
            if episode.ended:
                break
        done = episode.ended or self.prompt.plan
        self.messages = [] if done else self.prompt.messages(episode, self._steps[-self._history :])
        return self.messages

    def fly(self, directions: object) -> str:
        """Fly a tool call instead of an answer; returns what happened, and where the drone is now.

        Args:
            directions: 1 to `max_steps` names of actions, in any letter case. Those after the end are not flown.

        Raises:
            InvalidValueError: if it is anything else; nothing is flown then.
        """
        episode, most = self.episode, self.episode.task.max_steps
        route = cast(Sequence[object], directions) if isinstance(directions, list | tuple) else ()
        if not 0 < len(route) <= most:
            raise InvalidValueError(self.prompt.repair_text(f"A route is a list of 1 to {most} directions"))
        try:
            actions = actions_named(route)
        except InvalidValueError as error:
            raise InvalidValueError(self.prompt.repair_text(str(error))) from None
        told: dict[str, None] = {}
        for action in actions:
            episode.step(action)
            told[episode.message] = None
            if episode.ended:
                return " ".join(told)
        return f"{' '.join(told)} {status_text(episode)}"

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


class EpisodeRun(TextEpisode):
    """A flight of a run. Its calls can fail.

    Attributes:
        index: Its number in the run, from 0.
        repeat: The number of earlier flights of the run over the same map.
        parameters: The fields of its requests besides the messages.
        changes: What the last request changed, because the endpoint rejects it.
        body: The body of the last request.
        status: `finished` also if a route ended before the episode did.
        error: Why it is not finished.
    """

    index = repeat = 0
    parameters: Mapping[str, Any]
    changes: Changes = NO_CHANGES
    body: Mapping[str, Any]
    status: Status = "finished"
    error: str | None = None

    @property
    def key(self) -> CallKey:
        """The key of the next call."""
        return CallKey(self.index, len(self.turns) + 1, self.attempt)

    def request(self, changes: Changes) -> Mapping[str, Any]:
        """The body of the next request.

        Args:
            changes: What it changes because the endpoint rejects it; kept in `changes`.
        """
        self.changes, self.body = changes, changed({"messages": self.messages, **self.parameters}, changes)
        return self.body

    @property
    def begun(self) -> bool:
        """Whether it is more than a flight that a limit stopped before its first answer."""
        return self.status != "budget_stop" or self.attempt == 2 or bool(self.step_errors)

    def stop(self, status: Literal["errored", "budget_stop"], error: str) -> None:
        """End the flight because a call has no answer."""
        self.turns.append("api_error" if status == "errored" else status)
        self.status, self.error, self.messages = status, error, []
