"""The WebSocket of the page: episodes that fly by themselves or by hand, and the news of the server."""
