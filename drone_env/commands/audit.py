"""`drone-env audit`: whether maximising a reward also maximises the score."""

from typing import Any

from drone_env.commands.arguments import ProfileName, Split, TaskName
from drone_env.commands.printing import print_json, progress_bar
from drone_env.core.rewards import DEFAULT_PROFILE, get_reward_profile, profile_for_discount
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task
from drone_env.errors import InvalidValueError
from drone_env.results.tables import Table, number, plural, print_table


def audit(
    task: TaskName = "easy",
    reward: ProfileName = DEFAULT_PROFILE,
    gamma: float = 1.0,
    maps: int = 20,
    split: Split = "test",
    json: bool = False,
) -> int:
    """Compute the flight that maximises a reward, and its score.

    On each map, compare the exact return-maximising flight (in a tie, the one with the lowest score) with the exact
    optimum of the score. The verdict is `aligned` if the scores are equal on every map, else `exploitable`. Exit
    status: 0 for aligned, 1 for exploitable, 2 for an error.

    Potential-based shaping uses `gamma`, because it preserves the best flights only at the learner's discount.

    Example: drone-env audit --task easy --reward tiered --maps 50

    Args:
        task: The task, by its short name, id or grader.
        reward: A reward profile, or a TOML file with one.
        gamma: The learner's discount, 0 to 1.
        maps: Number of maps.
        split: The split; its first maps are used.
        json: Print JSON instead, also the actions over the worst map.
    """
    # Imported lazily: it loads a compiler.
    from drone_env.planning.audit import MapAudit, audit_maps, summarise_audits

    config = get_task(task)
    if maps < 1 or not 0 <= gamma <= 1:
        raise InvalidValueError(f"--maps must be at least 1, and --gamma 0 to 1; got {maps} and {gamma:g}")
    profile = profile_for_discount(get_reward_profile(reward), gamma)
    seeds = split_seeds(split, maps)
    with progress_bar(f"{config.short_name} {profile.id}", maps) as advance:
        audits: list[MapAudit] = []
        for audited in audit_maps(config, seeds, profile, gamma):
            audits.append(audited)
            advance()
    report = summarise_audits(config, profile, gamma, audits)
    if json:
        print_json(report)
    else:
        _print(report)
    return 0 if report["verdict"] == "aligned" else 1


RETURNS = {
    "maximiser": "the flight that earns most",
    "honest": "the flight that scores most",
}


def _print(report: dict[str, Any]) -> None:
    shaping = "" if report["shaping_gamma"] is None else f", shaping gamma {report['shaping_gamma']:g}"
    maps = plural(report["maps"], "map")
    title = f"{report['reward']} on {report['task']}, gamma {report['gamma']:g}{shaping}, {maps}"
    returns, worst = report["mean_returns"], report["worst"]
    rows = [(RETURNS[name], number(value, ".3f")) for name, value in returns.items()]
    better = [i for i, name in enumerate(returns) if name != "maximiser" and returns[name] > returns["honest"] + 1e-9]
    print_table(Table(title, ("flight", "mean return"), rows), names=1, alarming=better)
    print(
        f"The flight that earns most scores {report['mean_score']:.4f} on average; the optimum is "
        f"{report['mean_optimal_score']:.4f}.\nIt scores the optimum on {report['share_aligned']:.1%} of the maps.\n"
        f"Verdict: {report['verdict']}"
    )
    if report["verdict"] == "exploitable":
        print(f"Worst map: {worst['seed']}, {worst['score']:.4f} where {worst['optimal_score']:.4f} can be had")
