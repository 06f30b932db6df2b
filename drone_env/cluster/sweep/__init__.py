"""Sweeps: the same training under several settings and seeds, on Ray."""
