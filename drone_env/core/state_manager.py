"""The episode under the name of its original file."""

from drone_env.core.episode import Episode as Episode
