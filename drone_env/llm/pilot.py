"""An episode flown by a model: ask, fly. No other policy ever acts: an unusable answer is a WAIT, and counted."""

from collections.abc import Awaitable, Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from typing import Literal

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.llm.answers import Reading, TurnKind
from drone_env.llm.config import RunConfig
from drone_env.llm.desk import CallFailedError
from drone_env.llm.gate import LimitReachedError
from drone_env.llm.image import ServerSession
from drone_env.llm.messages import ChatMessage
from drone_env.llm.prompt import Prompt, first_messages, repair_messages
from drone_env.llm.transcript import CallKey

Ask = Callable[[CallKey, list[ChatMessage]], Awaitable[Reading]]
Status = Literal["finished", "errored", "budget_stop"]


@dataclass
class PilotedEpisode:
    """An episode that a model flies, as far as it was flown.

    Attributes:
        index: Its number in the run, from 0.
        repeat: How many flights of the run over the same map came before it.
        episode: The episode where the flight stopped.
        turns: How each request for actions came out, in order.
        step_errors: For each step, why it is a WAIT that the model did not choose; None where it chose.
        status: `finished` also where a route that was planned at once ended before the episode did.
        error: Why it was not finished.
        begun: Whether any answer came.
        names: What the prompt called actions and kinds of cells, where it drew names for them.
    """

    index: int
    repeat: int
    episode: Episode
    turns: list[TurnKind] = field(default_factory=list[TurnKind])
    step_errors: list[str | None] = field(default_factory=list[str | None])
    status: Status = "finished"
    error: str | None = None
    begun: bool = False
    names: dict[str, str] = field(default_factory=dict[str, str])


async def fly_one(config: RunConfig, index: int, ask: Ask, server: str | None = None) -> PilotedEpisode:
    """Fly one episode of a run.

    Args:
        config: The run.
        index: The number of the flight.
        ask: See `fly`.
        server: Address of a server that flies along.

    Raises:
        InvalidValueError: if the server shows something else.
    """
    seed, repeat = config.flight(index)
    flown = PilotedEpisode(index, repeat, Episode(config.task_config, config.profile, seed))
    with ExitStack() as stack:
        session = None if server is None else stack.enter_context(closing(ServerSession(server, config.model)))
        await fly(flown, config.load_prompt(), config.history, ask, session)
    return flown


async def fly(
    flown: PilotedEpisode, prompt: Prompt, history: int, ask: Ask, server: ServerSession | None = None
) -> None:
    """Fly an episode that has just been reset. Equal answers give equal flights.

    Args:
        flown: The episode.
        prompt: How the model is asked.
        history: How many of the last steps the prompt holds.
        ask: Brings the answer of one call; raises `CallFailedError` or `LimitReachedError` where there is none.
        server: Flies along, and must show the same.

    Raises:
        InvalidValueError: if the server shows something else.
    """
    episode = flown.episode
    symbols = prompt.symbols(episode.task, episode.seed)
    flown.names = dict(symbols.names)
    if server is not None:
        await server.reset(episode)
    steps: list[str] = []
    while not episode.ended:
        turn = len(flown.turns) + 1
        asked = first_messages(prompt, episode, steps[-history:] if history else ())
        try:
            reading = await ask(CallKey(flown.index, turn, 1), asked)
            flown.begun = True
            outcome: TurnKind = reading.kind
            if reading.kind != "ok":
                again = repair_messages(prompt, asked, reading.text, reading.reason, symbols)
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
            if server is not None:
                await server.step(episode, action)
            x, y = episode.position
            steps.append(f"{episode.steps}. {action.name} -> ({x}, {y}). {episode.message}")
            flown.step_errors.append(None if reading.actions else outcome)
        if prompt.plan:
            break
