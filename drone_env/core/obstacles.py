"""Collisions, under the original module name."""

from drone_env.core.rules import collision as collision
