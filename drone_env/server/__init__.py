"""The server: OpenEnv over WebSocket, flat JSON over HTTP."""
