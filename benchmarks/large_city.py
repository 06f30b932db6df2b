"""A task of 64 x 64 cells, as large as one can be, to measure the page with: a module for `DRONE_ENV_PLUGINS`."""

from dataclasses import replace

from drone_env import get_task, register_task

hard = get_task("hard")
register_task(
    replace(
        hard,
        id="large_city",
        short_name="large_city",
        grader="drone_env.graders:grade_large_city",
        width=64,
        height=64,
        buildings=600,
        trees=300,
        obstacles=200,
        deliveries=12,
        max_steps=2000,
        battery_capacity=2000,
    )
)
