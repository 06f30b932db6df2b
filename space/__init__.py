"""The clients of this Space's environment, where OpenEnv's tools look for them."""

from drone_env.client import DroneEnvClient
from drone_env.models import DroneAction, DroneObservation, DroneState
from drone_env.openenv_client import DroneDeliveryClient

__all__ = ["DroneAction", "DroneDeliveryClient", "DroneEnvClient", "DroneObservation", "DroneState"]
