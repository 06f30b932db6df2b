"""The functions of `tables`, compiled by Numba: the same source, not a second copy.

Importing this module costs Numba's import; compiling happens at the first call.
"""

from typing import Any

from numba.extending import register_jitable  # pyright: ignore

from drone_env.core import drone, grid_generator, observation, obstacles, rewards, rules, score, seeds
from drone_env.core.compile_cache import compiled_once

COMPILED = (
    seeds.wrap64,
    seeds.mix64,
    seeds.map_key,
    seeds.next_key,
    seeds.uniform_below,
    seeds.two_halves,
    seeds.next_seed,
    score.score_of,
    score.score,
    grid_generator.draw_road,
    grid_generator.place_anywhere,
    grid_generator.shuffle_in,
    grid_generator.move_parcel,
    grid_generator.place_along_streets,
    grid_generator.scatter,
    drone.move,
    drone.units_left,
    drone.use_battery,
    drone.distance,
    obstacles.collision,
    obstacles.flight_event,
    rewards.potential_of,
    rewards.reward_of,
    rules.reset,
    rules.step,
    rules.begin,
    rules.deliver,
    rules.choose_target,
    rules.outcome_of,
    rules.outcome,
    observation.write_telemetry,
    observation.write_own_telemetry,
    observation.write_target_telemetry,
    observation.open_actions,
)
# No step allocates, so reference counts are only a cost (`_nrt`); no divisor is ever zero (`error_model`); and the
# functions are pieces of one loop body (`forceinline`): a call would push all tables. Together they make a step nine
# times faster.
OPTIONS: dict[str, Any] = {"_nrt": False, "error_model": "numpy"}
for function in COMPILED:
    register_jitable(forceinline=True, **OPTIONS)(function)

reset = compiled_once(**OPTIONS)(rules.reset)
step = compiled_once(**OPTIONS)(rules.step)
