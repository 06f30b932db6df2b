"""Lazy imports of OpenEnv, because importing it takes seconds in each test process."""

from importlib import import_module
from typing import Any

_HOMES = {
    "CallToolAction": "openenv.core.env_server.mcp_types",
    "CommandLine": "openenv.cli.__main__:app",
    "DroneDeliveryClient": "drone_env.client",
    "DroneDeliveryEnvironment": "drone_env.server.grid_world_environment",
    "DroneEnvAction": "drone_env.server.grid_world_environment",
    "DroneEnvObservation": "drone_env.server.grid_world_environment",
    "DroneEnvState": "drone_env.server.grid_world_environment",
    "Environment": "openenv.core.env_server.interfaces",
    "GenericEnvClient": "openenv.core.generic_client",
    "Level": "openenv.validation",
    "MCPToolClient": "openenv.core.mcp_client",
    "McpClient": "fastmcp:Client",
    "create_fastapi_app": "openenv.core.env_server",
    "push": "openenv.cli.commands",
    "run_validation": "openenv.validation",
    "validate_running_environment": "openenv.cli._validation",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(name)
    home, _, other = _HOMES[name].partition(":")
    return getattr(import_module(home), other or name)
