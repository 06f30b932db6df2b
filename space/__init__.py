"""The clients of this Space's environment, where OpenEnv's tools look for them."""

from drone_env.client import DroneDeliveryClient, DroneEnvClient
from drone_env.models import DroneAction, DroneObservation, DroneState

__all__ = ["DroneAction", "DroneDeliveryClient", "DroneEnvClient", "DroneObservation", "DroneState"]
