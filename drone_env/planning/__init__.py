"""Planners: exact and heuristic."""
