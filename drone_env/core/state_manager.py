"""The episode, under the original module name."""

from drone_env.core.episode import Episode as Episode
