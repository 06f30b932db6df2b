"""Movement and battery, under the original module name."""

from drone_env.core.rules import move as move
from drone_env.core.rules import units_left as units_left
