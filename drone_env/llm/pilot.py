"""One flight of a model: ask, read, fly. No other policy ever acts: an unusable answer is a WAIT, and counted."""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Literal

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.errors import DroneEnvError
from drone_env.llm.answers import Answer, Outcome, read_answer
from drone_env.llm.config import RunConfig
from drone_env.llm.image import ServerFlight
from drone_env.llm.limits import LimitReachedError
from drone_env.llm.prompt import ChatMessage, Flown, Prompt, first_messages, repair_messages
from drone_env.llm.transcript import CallKey
from drone_env.models import DroneObservation

Ask = Callable[[CallKey, list[ChatMessage]], Awaitable[Answer]]
Status = Literal["finished", "errored", "budget_stop"]


@dataclass(frozen=True)
class Mission:
    """What is to be flown.

    Attributes:
        index: The number of the flight, from 0.
        seed, repeat: The map, and the how manieth flight over it from 0.
        task: The task.
        reward_profile: What steps pay.
        history: How many of the last steps are told.
        agent: Who flies, for a server's records.
    """

    index: int
    seed: int
    repeat: int
    task: TaskConfig
    reward_profile: str
    history: int
    agent: str


def mission_of(config: RunConfig, index: int) -> Mission:
    """A flight of a run, by its number."""
    seed, repeat = config.flight(index)
    return Mission(index, seed, repeat, config.task_config, config.reward_profile, config.history, config.model)


class CallFailedError(DroneEnvError):
    """A call brought no answer, after all retries."""


@dataclass
class Flight:
    """A flight as far as it was flown.

    Attributes:
        index: Its number in the run.
        seed, repeat: The map, and the how manieth flight over it from 0.
        episode: The episode where the flight stopped.
        turns: How each request for actions came out, in order.
        step_errors: For each step, why it is a WAIT that the model did not choose; None where it chose.
        status: `finished` also where a route that was planned at once ended before the episode did.
        error: Why it was not finished.
        begun: Whether any answer came.
    """

    index: int
    seed: int
    repeat: int
    episode: Episode
    turns: list[Outcome] = field(default_factory=list[Outcome])
    step_errors: list[str | None] = field(default_factory=list[str | None])
    status: Status = "finished"
    error: str | None = None
    begun: bool = False


async def fly(mission: Mission, prompt: Prompt, ask: Ask, server: ServerFlight | None = None) -> Flight:
    """Fly one flight. Equal answers give equal flights.

    Args:
        mission: The flight.
        prompt: How the model is asked.
        ask: Brings the answer of one call; raises `CallFailedError` or `LimitReachedError` where there is none.
        server: Flies along, and must show the same.

    Raises:
        InvalidValueError: if the server shows something else.
    """
    index, task = mission.index, mission.task
    episode = Episode(task, mission.reward_profile)
    episode.reset(mission.seed)
    flight = Flight(index, mission.seed, mission.repeat, episode)
    if server is not None:
        await server.reset(episode, mission.agent)
    flown: list[Flown] = []
    while not episode.ended:
        turn = len(flight.turns) + 1
        asked = first_messages(prompt, task, DroneObservation.of(episode), flown, mission.history)
        try:
            answer = await ask(CallKey(index, turn, 1), asked)
            flight.begun = True
            reading = read_answer(answer, prompt.plan)
            outcome: Outcome = reading.kind
            if reading.kind != "ok":
                shown = answer.text if answer.tool_arguments is None else answer.tool_arguments
                again = repair_messages(prompt, asked, shown, reading.reason)
                reading = read_answer(await ask(CallKey(index, turn, 2), again), prompt.plan)
                outcome = "repaired" if reading.kind == "ok" else reading.kind
        except CallFailedError as error:
            flight.turns.append("api_error")
            flight.status, flight.error = "errored", str(error)
            break
        except LimitReachedError as error:
            flight.turns.append("budget_stop")
            flight.status, flight.error = "budget_stop", str(error)
            break
        flight.turns.append(outcome)
        for action in reading.actions or (Action.WAIT,):
            if episode.ended:
                break
            episode.step(action)
            if server is not None:
                await server.step(episode, action)
            x, y = episode.position
            flown.append(Flown(action.name, x, y, episode.message))
            flight.step_errors.append(None if reading.actions else outcome)
        if prompt.plan:
            break
    return flight
