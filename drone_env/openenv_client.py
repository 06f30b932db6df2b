"""The OpenEnv client: one session over a WebSocket. Importing it imports OpenEnv, which takes seconds."""

from typing import Any

from openenv.core.client_types import StepResult
from openenv.core.env_client import EnvClient

from drone_env.errors import InvalidValueError
from drone_env.models import DroneAction, DroneObservation, DroneState


class DroneDeliveryClient(EnvClient[DroneAction, DroneObservation, DroneState]):
    """A client of `/ws`: asynchronous, or synchronous after `sync()`.

        with DroneDeliveryClient("http://localhost:8000").sync() as env:
            result = env.reset(task_name="hard", seed=7)
            while not result.done:
                result = env.step(DroneAction(direction="RIGHT"))

    Options of `reset`: `seed`, `episode_id`, `task_name`, `reward_profile`, `prompt`, `agent`, or `split` and `index`.
    The `metadata` of a result contains `reward_profile`, `flown` after a step, and `prompt`.
    """

    def _step_payload(self, action: object) -> dict[str, Any]:
        if not isinstance(action, DroneAction):
            raise InvalidValueError(f'step takes a DroneAction, such as DroneAction(direction="UP"); got {action!r}')
        return action.model_dump()

    def _parse_result(self, payload: dict[str, Any]) -> StepResult[DroneObservation]:
        fields = dict(payload["observation"])
        metadata = fields.pop("metadata") | {"prompt": fields.pop("prompt")}
        observation = DroneObservation(**fields, done=payload["done"])
        return StepResult(observation=observation, reward=payload["reward"], done=payload["done"], metadata=metadata)

    def _parse_state(self, payload: dict[str, Any]) -> DroneState:
        return DroneState.model_validate(payload)
