"""Datasets of flights with the exact values of every step: `build_dataset`."""
