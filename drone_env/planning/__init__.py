"""Planners: exact and greedy."""
