"""The OpenEnv environment under the name of its original file."""

from drone_env.server.openenv.environment import DroneDeliveryEnvironment as DroneDeliveryEnvironment
