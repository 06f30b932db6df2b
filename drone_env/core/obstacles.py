"""Collisions, under the name of the original file."""

from drone_env.core.rules import collision as collision
