"""The route of the network's next action."""

from typing import Literal

import numpy as np
from fastapi import APIRouter
from pydantic import Field

from drone_env.agents.pathqnet import PathQNetAgent
from drone_env.models import DIRECTIONS, Direction, StrictModel
from drone_env.server.exceptions import RequestError
from drone_env.server.routes.flight import SessionDep
from drone_env.server.state import SESSION_ERRORS, AppStateDep

router = APIRouter(tags=["flight"])


class ModelInfo(StrictModel):
    """The network behind a prediction."""

    name: Literal["pathqnet"] = "pathqnet"
    file: str = Field(description="Name of its file.")
    digest: str = Field(description="First 16 digits of the SHA-256 of that file.")


class Prediction(StrictModel):
    """The next action by the network."""

    action: Direction = Field(description="The action with the highest value.")
    q_values: dict[Direction, float] = Field(description="Value of each action.")
    model: ModelInfo


@router.post("/predict", responses=SESSION_ERRORS)
def predict(app_state: AppStateDep, session: SessionDep) -> Prediction:
    """The action of the trained network for the session's episode."""
    episode, networks = session.episode, app_state.networks
    if episode.ended:
        raise RequestError(409, "ended", "the episode has ended: start another with POST /reset")
    task = episode.task
    pilot = networks.preferred(task)
    if pilot is None:
        detail = f"there is no network for {task.id!r}; train one: drone-env train --task {task.short_name}"
        raise RequestError(503, "no_network", detail)
    agent = networks.network(pilot, task)
    assert isinstance(agent, PathQNetAgent)
    values = agent.q_values(episode.observation())
    return Prediction(
        action=DIRECTIONS[int(np.argmax(values))],
        q_values=dict(zip(DIRECTIONS, values.tolist(), strict=True)),
        model=ModelInfo(file=networks.file(pilot, task).name, digest=str(agent.config["network"])),
    )
