"""The map generator under the name of its original file."""

from drone_env.core.grid_generator import CityMap as CityMap
from drone_env.core.grid_generator import generate_city_map as generate_city_map
