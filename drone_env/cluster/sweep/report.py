"""The figures of a sweep: each setting over its seeds, each trial with the command that trains it alone."""

from collections import Counter
from statistics import fmean
from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.cluster.sweep.config import SweepConfig, Trial
from drone_env.cluster.sweep.folder import SweepFolder, TrialState
from drone_env.core.seeds import split_seeds
from drone_env.results.evaluate import episodes_key, run_episodes, summarise
from drone_env.results.statistics import SCORES, SHARES, Range, crossed


def sweep_report(folder: SweepFolder, config: SweepConfig) -> dict[str, Any]:
    """The figures of a sweep, as JSON values; what is not known is null.

    `test` of a setting is over the seeds that finished: mean score and ratio to the optimum of the same test maps,
    each with its interval (95 %) over seeds and maps. Settings that were stopped early have none, and are
    ranked by their validation scores where they were stopped; they come after the others. A trial that failed counts in
    nothing, and its setting says how many seeds are behind its figures.
    """
    decisions = folder.stopped()
    stopped_at = {setting: decision.episodes for decision in decisions for setting in decision.stopped}
    trials: list[dict[str, Any]] = []
    settings: list[dict[str, Any]] = []
    for setting, values in enumerate(config.settings):
        states = {trial: folder.state(trial) for trial in config.trials() if trial.setting == setting}
        at = stopped_at.get(setting)
        trials += [_trial(folder, config, trial, state, at) for trial, state in states.items()]
        finished = [state for state in states.values() if state.status == "finished"]
        settings.append(
            {
                "setting": setting,
                "label": config.label(setting),
                "values": values,
                "stopped_at": at,
                "seeds": config.seeds,
                "seeds_finished": len(finished),
                "seeds_failed": sum(state.status == "failed" for state in states.values()),
                "validation": {
                    str(decision.episodes): decision.values[str(setting)]
                    for decision in decisions
                    if str(setting) in decision.values
                },
                "test": None if at is not None else _test(finished),
            }
        )
    count = Counter(trial["status"] for trial in trials)
    optima = [trial["validation_optimum"] for trial in trials if trial["validation_optimum"] is not None]
    greedy = summarise(run_episodes(episodes_key(config.task, "greedy", split_seeds("test", config.test_maps), "test")))
    return {
        "format": "drone_env/sweep-report",
        "config": config.model_dump(mode="json"),
        "common": config.common(),
        "trials_by_status": {name: count[name] for name in ("finished", "stopped", "failed", "unfinished")},
        "validation_optimum": optima[0] if optima else None,
        "greedy": {"score": greedy["mean_score"], "ratio": greedy["score_ratio"]},
        "settings": sorted(settings, key=_rank),
        "trials": trials,
    }


def write_report(folder: SweepFolder, figures: dict[str, Any]) -> None:
    """Write `report.json`, `report.md` and the plots into the sweep's folder, each whole or not at all.

    Raises:
        OSError: if they cannot be written.
    """
    from drone_env.cluster.sweep.plots import draw_plots
    from drone_env.results.pages import render, write_pages

    draw_plots(figures, folder.path)
    write_pages(folder.path, figures, {"report.md": render("sweep.md", **figures)})


def _trial(
    folder: SweepFolder, config: SweepConfig, trial: Trial, state: TrialState, stopped_at: int | None
) -> dict[str, Any]:
    stopped = state.status == "unfinished" and stopped_at is not None
    test = state.test
    score = None if test is None else fmean(test.scores)
    return {
        "name": trial.name,
        "setting": trial.setting,
        "seed": trial.seed,
        **state.model_dump(exclude={"rungs", "test"}),
        "status": "stopped" if stopped else state.status,
        "stopped_at": stopped_at if stopped else None,
        "parts": len(folder.parts(trial)),
        "test_score": score,
        "test_ratio": score / fmean(test.optima) if test and score is not None and test.optima else None,
        "test_success": None if test is None else test.success_rate,
        "command": config.command(trial),
    }


def _test(finished: list[TrialState]) -> dict[str, Any] | None:
    flown = [state.test for state in finished if state.test is not None]
    if not flown:
        return None
    scores, optima = np.array([test.scores for test in flown]), flown[0].optima
    ratio = None
    if optima is not None:
        # Linearised: what a map adds to mean score / mean optimum, which hard maps lower in both.
        best = np.array(optima)
        share = scores.mean() / best.mean()
        ratio = _figure(share + (scores - share * best) / best.mean(), SHARES)
    return {
        "score": _figure(scores, SCORES),
        "ratio": ratio,
        "seed_scores": [fmean(test.scores) for test in flown],
        "optimum": None if optima is None else fmean(optima),
        "success": fmean(test.success_rate for test in flown),
    }


def _figure(values: npt.NDArray[np.float64], within: Range) -> dict[str, Any]:
    found = crossed(values, within)
    return {"mean": float(values.mean()), "ci95": None if found is None else [found.low, found.high]}


def _rank(setting: dict[str, Any]) -> tuple[float, float, float]:
    """Best first: the finished by score, then those without figures, the later stopped first, then by validation."""
    test, last = setting["test"], max(setting["validation"].values(), default=0.0)
    return (-test["score"]["mean"], 0, 0) if test else (1, -(setting["stopped_at"] or 0), -last)
