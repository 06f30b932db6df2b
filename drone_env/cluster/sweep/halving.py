"""Which settings are stopped early: successive halving of settings, never of seeds.

Jamieson and Talwalkar, "Non-stochastic best arm identification and hyperparameter optimization", AISTATS 2016. At a
quarter and at half of the episodes all seeds of all settings still in are waited for, and the better half of the
settings, by the mean over its seeds, goes on. A setting goes on or stops with all of its seeds: to stop single trials
would stop the unlucky seeds and keep the lucky ones, and the mean over those that are left would show luck. As all
are waited for, the decision depends on nothing but the values: not on how many train side by side, nor on what died.
"""

import math
from collections.abc import Sequence

from drone_env.cluster.sweep.config import SweepConfig, Trial
from drone_env.cluster.sweep.folder import StoppedSettings, SweepFolder

SHARES = (0.25, 0.5)


def rungs(config: SweepConfig) -> list[int]:
    """The episodes at which settings are compared, each a multiple of those between two validations."""
    training = config.training(Trial(0, 0))
    if not config.early_stopping or len(config.settings) < 2:
        return []
    every = training.validation_every
    found = sorted({math.ceil(training.episodes * share / every) * every for share in SHARES})
    return [episodes for episodes in found if episodes < training.episodes]


def remaining(config: SweepConfig, decisions: Sequence[StoppedSettings]) -> list[int]:
    """The settings that were not stopped."""
    gone = {setting for decision in decisions for setting in decision.stopped}
    return [setting for setting in range(len(config.settings)) if setting not in gone]


def decide(folder: SweepFolder, config: SweepConfig, episodes: int) -> StoppedSettings:
    """Compare the settings at a rung, once, and write down which are stopped: all that are below the median.

    Settings as good as the last that goes on go on too. Trials that failed before the rung do not count; a setting
    that has no other is left to its failures.
    """
    decisions = folder.stopped()
    for decision in decisions:
        if decision.episodes == episodes:
            return decision
    values: dict[int, float] = {}
    for setting in remaining(config, decisions):
        states = [folder.state(Trial(setting, seed)) for seed in range(config.seeds)]
        reached = [state.rungs[str(episodes)] for state in states if str(episodes) in state.rungs]
        if reached:
            values[setting] = math.fsum(reached) / len(reached)
    ordered = sorted(values.values(), reverse=True)
    least = ordered[math.ceil(len(ordered) / 2) - 1] if ordered else 0.0
    decision = StoppedSettings(
        episodes=episodes,
        values={str(setting): value for setting, value in values.items()},
        stopped=[setting for setting, value in values.items() if value < least],
    )
    folder.set_stopped([*decisions, decision])
    return decision
