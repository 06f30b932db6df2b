"""Work on many machines, on Ray (extra `cluster`). Nothing here is imported where the local engine works."""
