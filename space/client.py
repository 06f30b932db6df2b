"""The clients of this Space's environment, where OpenEnv's tools look for them."""

from drone_env.client import DroneEnvClient
from drone_env.openenv_client import DroneDeliveryClient

__all__ = ["DroneDeliveryClient", "DroneEnvClient"]
