"""The drone as a taskset of verifiers: `vf-eval drone_delivery`."""

from drone_delivery.taskset import DroneDeliveryEnv, DroneDeliveryTaskset

__all__ = ["DroneDeliveryEnv", "DroneDeliveryTaskset"]
