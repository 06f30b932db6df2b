"""The clients of this Space's environment, where OpenEnv's tools look for them."""

from drone_env.client import DroneDeliveryClient, DroneEnvClient

__all__ = ["DroneDeliveryClient", "DroneEnvClient"]
