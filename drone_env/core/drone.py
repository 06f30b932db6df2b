"""How the drone moves and what that costs, under the name of the original file."""

from drone_env.core.rules import move as move
from drone_env.core.rules import units_left as units_left
