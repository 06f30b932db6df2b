"""OpenEnv: the session, its WebSocket, the task API, the environment for those who bring OpenEnv, the client."""
