"""A flight of a language model: ask, step. An unusable answer is a WAIT and is counted; no other policy ever acts."""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from typing_extensions import Self

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.errors import DroneEnvError
from drone_env.llm.answers import Reading, TurnKind
from drone_env.llm.content import ChatMessage
from drone_env.llm.limiter import LimitReachedError
from drone_env.llm.prompt import Prompt, first_messages, repair_messages
from drone_env.llm.transcript import CallKey

if TYPE_CHECKING:
    from drone_env.llm.config import RunConfig

Ask = Callable[[CallKey, list[ChatMessage]], Awaitable[Reading]]
OnStep = Callable[[Episode], Awaitable[None]]
Status = Literal["finished", "errored", "budget_stop"]


class CallFailedError(DroneEnvError):
    """A call brought no answer, after all retries."""


@dataclass
class PilotedEpisode:
    """An episode that a model flies, in its current state.

    Attributes:
        index: Its number in the run, from 0.
        repeat: The number of earlier flights of the run over the same map.
        episode: The episode.
        turns: The outcome of each request for actions, in order.
        step_errors: For each step, why it is a WAIT that the model did not choose; None if it chose.
        status: `finished` also if a route that was planned at once ended before the episode did.
        error: Why it is not finished.
        begun: Whether any answer came.
    """

    index: int
    repeat: int
    episode: Episode
    turns: list[TurnKind] = field(default_factory=list[TurnKind])
    step_errors: list[str | None] = field(default_factory=list[str | None])
    status: Status = "finished"
    error: str | None = None
    begun: bool = False

    @classmethod
    def begin(cls, config: "RunConfig", index: int) -> Self:
        """The flight of this number in a run, after its reset: all maps once, then all again."""
        repeat, offset = divmod(index, config.seeds[1] - config.seeds[0])
        return cls(index, repeat, Episode(config.task_config, config.profile, config.seeds[0] + offset))


async def fly(
    flown: PilotedEpisode, prompt: Prompt, history: int, ask: Ask, on_step: OnStep | None = None
) -> PilotedEpisode:
    """Fly an episode that has just been reset, and return it. Equal answers give equal flights.

    Args:
        flown: The episode.
        prompt: How to ask the model.
        history: How many of the last steps the prompt shows.
        ask: Returns the answer to a call; raises `CallFailedError` or `LimitReachedError` if there is none.
        on_step: Called after the reset and after each step.
    """
    episode = flown.episode
    if on_step is not None:
        await on_step(episode)
    steps: list[str] = []
    while not episode.ended:
        turn = len(flown.turns) + 1
        asked = first_messages(prompt, episode, steps[-history:] if history else ())
        try:
            reading = await ask(CallKey(flown.index, turn, 1), asked)
            flown.begun = True
            outcome: TurnKind = reading.kind
            if reading.kind != "ok":
                again = repair_messages(prompt, asked, reading.text, reading.reason)
                reading = await ask(CallKey(flown.index, turn, 2), again)
                outcome = "repaired" if reading.kind == "ok" else reading.kind
        except CallFailedError as error:
            flown.turns.append("api_error")
            flown.status, flown.error = "errored", str(error)
            break
        except LimitReachedError as error:
            flown.turns.append("budget_stop")
            flown.status, flown.error = "budget_stop", str(error)
            break
        flown.turns.append(outcome)
        for action in reading.actions or (Action.WAIT,):
            if episode.ended:
                break
            episode.step(action)
            if on_step is not None:
                await on_step(episode)
            x, y = episode.position
            steps.append(f"{episode.steps}. {action.name} -> ({x}, {y}). {episode.message}")
            flown.step_errors.append(None if reading.actions else outcome)
        if prompt.plan:
            break
    return flown
