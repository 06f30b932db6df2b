"""Maps as tasks, and an environment whose user is the drone: it answers each action with the next observation.

Prompts, answers and flights are those of `drone-env infer`, but all turns of a flight are one conversation.
"""

import asyncio
from collections.abc import Iterator
from itertools import pairwise

import verifiers.v1 as vf

from drone_env.core.seeds import split_seeds
from drone_env.errors import TooLargeError
from drone_env.flights.record import record_of
from drone_env.llm.answers import Answer, Unusable
from drone_env.llm.text_episode import TextEpisode
from drone_env.planning.optimal import solver_of


class FlightData(vf.TaskData):
    """A map, and the prompt of its flights."""

    flight: tuple[str, int, str]
    """Task, seed, prompt."""


class FlightTask(vf.Task[FlightData]):
    """A flight over a map."""


class DroneDeliveryConfig(vf.TasksetConfig):
    """Options of the taskset, under `--env.taskset`."""

    task: vf.TaskConfig = vf.TaskConfig()
    map_task: str = "easy"
    """The task: id, short name or grader."""
    prompt: str = "plan"
    """The prompt: name (the newest version), id, or your own file. Only `plan` and `think-plan` need a single turn."""
    split: str = "train"
    """Split of the maps: `train`, `validation` or `test`."""
    maps: int = 1000
    """Number of maps, one task each."""
    offset: int = 0
    """Index of the first map within the split."""


class DroneDeliveryTaskset(vf.Taskset[FlightTask, DroneDeliveryConfig]):
    """The maps of a split."""

    def load(self) -> Iterator[FlightTask]:
        """Yield one task for each map."""
        config = self.config
        for seed in split_seeds(config.split, config.maps, config.offset):
            *system, user = TextEpisode(config.map_task, seed, config.prompt).messages
            data = FlightData(
                name=f"{config.map_task}#{seed}",
                system_prompt=system[0]["content"] if system else None,
                prompt=user["content"],
                flight=(config.map_task, seed, config.prompt),
            )
            yield FlightTask(data, config.task)


class DroneDeliveryEnvConfig(vf.EnvConfig):
    """Options of the environment, under `--env`."""

    pilot: vf.AgentConfig = vf.AgentConfig(harness={"id": "null"}, runtime={"type": "subprocess"})
    """The model. Its harness has no tools and runs none of its output, so it needs no sandbox."""


class DroneDeliveryEnv(vf.Env[DroneDeliveryEnvConfig]):
    """One flight. Its reward is the score; a flight that stops early counts as waiting to its end.

    `trace.info["turn_rewards"]` contains the change of V*, the highest score that can still be reached, for each of the
    model's turns. Their sum is minus the regret of the flight. It is missing if the map is too large to be solved.
    """

    async def run(self, task: FlightTask, agents: vf.Agents) -> None:
        """Fly a task to the end."""
        flight = TextEpisode(*task.data.flight)
        try:
            solver = await asyncio.to_thread(solver_of, flight.episode)
        except TooLargeError:
            solver = None
        values = [solver.value(flight.episode)] if solver else []
        async with agents.pilot.interaction(task) as interaction:
            segment = await interaction.turn()
            while not segment.terminated:
                calls = interaction.trace.calls
                reason = calls[-1].finish_reason if calls else None
                messages = flight.answer(Answer(text=segment.last_reply, finish_reason=reason))
                if solver:
                    # After the last turn nothing but waiting follows.
                    values.append(solver.value(flight.episode) if messages else flight.score)
                if not messages:
                    break
                segment = await interaction.turn(messages[-1]["content"])
        trace = interaction.trace
        if values:
            # A limit can stop the flight too, even before its first answer.
            values[max(1, len(values) - 1) :] = [flight.score]
            trace.info["turn_rewards"] = [after - before for before, after in pairwise(values)]
        trace.info["record"] = record_of(flight.episode, str(trace.agent.config.model)).to_json()
        trace.record_reward("score", flight.score)
        share = Unusable.among({kind: flight.turns.count(kind) for kind in set(flight.turns)}).share
        measures = {
            "success": flight.success,
            "regret": flight.regret,
            "unusable": share,
            "steps": flight.episode.steps,
        }
        for name, value in measures.items():
            if value is not None:
                trace.record_metric(name, float(value))
