"""The WebSocket of the page: missions that fly by themselves or by hand, and what goes on at the server."""
