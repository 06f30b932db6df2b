"""The WebSocket of the page: its episodes, and updates about the server."""
