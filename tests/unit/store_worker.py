"""A process that flies one session of a store at random and says what has been kept: run by the tests of the store.

    python store_worker.py FOLDER SESSION STEPS RANDOM_SEED

After each step it prints one line of JSON: [seed of the map, actions so far, id of the finished episode or null].
"""

import json
import os
import random
import sys

from drone_env.core.episode import Episode
from drone_env.results.sessions import advance
from drone_env.results.store import Store


def say(value: object) -> None:
    # One write, so that a killed process leaves whole lines but for the last.
    os.write(1, f"{json.dumps(value)}\n".encode())


def main(folder: str, session: str, steps: int, random_seed: int) -> None:
    rng = random.Random(random_seed)
    with Store(folder) as store:
        say("ready")
        for _ in range(steps):
            with store.session(session) as row:
                if row.episode_id is not None:
                    row.begin(Episode(row.task, row.reward_profile, row.seed + 1))
                advance(row, rng.randrange(5))
            say([row.seed, row.actions, row.episode_id])


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
