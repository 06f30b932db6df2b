"""`drone-env infer`: a language model flies."""

import contextlib
import dataclasses
import json as json_format
import sys
from datetime import datetime, timezone
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from drone_env.commands.arguments import ChosenTask, ClusterAddress, ProfileName, SeedRange, SplitName, chosen_maps
from drone_env.core.rewards import ORIGINAL_PROFILE, own_profile
from drone_env.core.tasks import get_task, own_rules
from drone_env.envs.registry import register_city
from drone_env.errors import InvalidValueError, needs, text_of
from drone_env.files import RUNS
from drone_env.llm.options import Number, Options, Whole

PROMPTS = "minimal|grid|coordinates|plan|think|think-plan|vision|original|FILE.toml"
PromptName = Annotated[str | None, tyro.conf.arg(metavar=PROMPTS)]
PromptNames = Annotated[tuple[str, ...], tyro.conf.arg(metavar=PROMPTS)]
DEFAULTS = Options()


def infer(
    task: ChosenTask = None,
    model: str | None = None,
    base_url: str | None = None,
    episodes: Whole = None,
    split: SplitName = None,
    seeds: SeedRange = None,
    repeats: int = 1,
    prompt: PromptName = None,
    prompts: PromptNames = (),
    history: int = 0,
    answers: Literal["text", "json", "tool"] = "text",
    temperature: Number = 0.0,
    no_temperature: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    top_p: Number = None,
    max_answer_tokens: int = 1024,
    sampling_seed: Whole = None,
    extra: str = "{}",
    reward_profile: ProfileName = ORIGINAL_PROFILE,
    options: Annotated[Options, tyro.conf.arg(name="")] = DEFAULTS,
    data: Path | None = None,
    out: Path | None = None,
    resume: bool = False,
    report: bool = True,
    moves: bool = True,
    use_image: bool = False,
    engine: Literal["local", "ray"] = "local",
    address: ClusterAddress = None,
) -> int:
    """Let a language model of any OpenAI-compatible endpoint fly, and say what it is worth.

    Standard output holds one [START] line, one [STEP] line per step and one [END] line for each flight, together, and
    nothing else. HF_TOKEN, OPENAI_API_KEY, API_BASE_URL, MODEL_NAME and DRONE_TASK come from the environment or .env.
    An answer that cannot be used is asked for once more, then it is a WAIT and counted; nobody else ever flies for the
    model. Exit status: 0 for a valid run, 1 if more than 5 % of the flights errored (INVALID), 2 if the endpoint
    refuses or something else is wrong, 3 if a limit was reached.

    Example: drone-env infer --task easy --episodes 100 --out runs/qwen-easy

    Args:
        task: The task, by its short name, id or grader; DRONE_TASK if nothing is said.
        model: The model; MODEL_NAME if nothing is said.
        base_url: The endpoint; API_BASE_URL if nothing is said.
        episodes: How many maps of the split, 1 if nothing is said.
        split: Whose first maps to fly: test if nothing is said.
        seeds: Fly the maps from A up to and not including B instead of a split's.
        repeats: Flights over each map, for pass^k; each sends a sampling seed of its own.
        prompt: The prompt, by its name (the newest version) or id, such as grid-2, or a file of your own; minimal if
            nothing is said, or with --resume that of the run.
        prompts: Fly the same with each of these prompts, one after another, and compare them map by map. Each run has a
            folder of its prompt's id in --out; limits hold for each.
        history: How many of the last steps the prompt names.
        answers: Ask for plain text, for structured output (JSON schema), or for a tool call.
        temperature: Sampling temperature.
        no_temperature: Send no temperature, for models that take none.
        top_p: Nucleus sampling; not sent if nothing is said.
        max_answer_tokens: The longest answer in tokens, sent as max_tokens; 0 sends none.
        sampling_seed: The endpoint's sampling seed, to which the number of the repeat is added: with --repeats 3 and 5,
            the flights over a map send 5, 6 and 7. Not sent if nothing is said.
        extra: More of the request's body, as a JSON object, such as '{"reasoning_effort": "low"}'.
        reward_profile: What steps pay: a reward profile, or a TOML file with one.
        options: How the run is made.
        data: Folder of the store that keeps the flights, where a server finds them; DRONE_ENV_DATA if nothing is said,
            else data. A server that flies along keeps them itself.
        out: The run folder; llm/ in the folder of the store and a name of its own if nothing is said.
        resume: Go on with the run in --out, under the same configuration.
        report: Check the whole run once more and write report.md, report.json and report.html into its folder.
        moves: Say in the report how many moves were blunders, beside the exact value of every state.
        use_image: Start the Docker image LOCAL_IMAGE_NAME and fly in its server. Each of its observations must be the
            one that the rules here give.
        engine: Send the requests from this process, or from the nodes of a Ray cluster (extra `cluster`), which share
            one budget and one run folder.
        address: The cluster: local starts one on this machine (if nothing is said), auto joins the one that runs here,
            HOST:PORT joins that one.
    """
    import asyncio

    from drone_env.files import data_folder
    from drone_env.results.store import Store

    with needs("llm"):
        from drone_env.llm import run_folder, runner
        from drone_env.llm.config import RunConfig, Sampling
        from drone_env.llm.endpoint import Endpoint
        from drone_env.llm.image import running_image
        from drone_env.llm.limiter import RateLimiter
        from drone_env.llm.progress import ConsoleObserver
        from drone_env.llm.prompt import get_prompt
        from drone_env.llm.settings import check_url, load_settings, token_for
    from pydantic import ValidationError

    chosen_split, maps = chosen_maps(seeds, split, episodes, 1)
    if prompt is not None and prompts:
        raise InvalidValueError("--prompts names all prompts: give it without --prompt")
    settings = load_settings(base_url)
    named = settings.drone_task if task is None else task
    config_task = register_city(named) if named.endswith(".toml") else get_task(named)
    if resume and out and not prompts and prompt is None and (out / run_folder.CONFIG).exists():
        chosen = [run_folder.load_config(out).load_prompt()]
    else:
        chosen = [get_prompt(name) for name in prompts or (prompt or "minimal",)]
    try:
        more = json_format.loads(extra)
        sampling = Sampling(
            temperature=None if no_temperature else temperature,
            top_p=top_p,
            max_tokens=max_answer_tokens or None,
            seed=sampling_seed,
            extra=more,
        )
        configs = [
            RunConfig(
                model=settings.model_name if model is None else model,
                base_url=check_url(settings.api_base_url),
                task=config_task.id,
                task_version=config_task.version,
                rules=own_rules(config_task),
                split=chosen_split,
                seeds=(maps.start, maps.stop),
                repeats=repeats,
                reward_profile=reward_profile,
                rewards=own_profile(reward_profile),
                prompt=one.id,
                prompt_digest=one.digest,
                prompt_text=one.own,
                history=history,
                answers=answers,
                sampling=sampling,
            )
            for one in chosen
        ]
    except ValidationError as error:
        raise InvalidValueError(text_of(error)) from None
    except (json_format.JSONDecodeError, RecursionError) as error:
        raise InvalidValueError(f"--extra takes a JSON object: {error}") from None
    token = token_for(settings, configs[0].base_url)
    if use_image and options.server is not None:
        raise InvalidValueError("--use-image starts a server itself: give it without --server")
    if address is not None and engine != "ray":
        raise InvalidValueError("--address names a cluster: give it with --engine ray")
    data = data_folder() if data is None else data
    root = out or _new_folder(data / RUNS, configs[0].model, config_task.short_name)

    paths = {config.prompt: root / config.prompt if prompts else root for config in configs}
    begun = [name for name, path in paths.items() if (path / run_folder.CONFIG).exists()]
    if resume and not begun:
        raise InvalidValueError(f"there is no run in {root} to resume")
    go_on = f"give the same options with --out {root} --resume"
    found: list[dict[str, Any]] = []
    status = 0
    with contextlib.ExitStack() as stack:
        if use_image:
            options = dataclasses.replace(options, server=stack.enter_context(running_image(settings.local_image_name)))
        store = None if options.server is not None else stack.enter_context(Store(data))
        if engine == "ray":
            from drone_env.cluster.connect import connect

            stack.enter_context(connect(address))
        for config in configs:
            folder = run_folder.RunFolder(paths[config.prompt], config, resume and config.prompt in begun)
            with contextlib.closing(folder):
                if engine == "ray":
                    from drone_env.cluster.senders import ClusterEndpoint

                    sender = ClusterEndpoint(config, token, options)
                else:
                    sender = Endpoint(config, token, options.timeout)
                limiter = RateLimiter(options)
                observer = ConsoleObserver(config, limiter, folder, store)
                try:
                    result = asyncio.run(runner.run(config, folder, sender, limiter, observer))
                    if report:
                        from drone_env.llm.report import report as figures_of
                        from drone_env.llm.report import write_report
                        from drone_env.llm.verify import verified_run

                        checked = verified_run(folder.path)
                        found.append(figures_of(checked, options.prices, moves))
                        write_report(checked, found[-1])
                except KeyboardInterrupt:
                    print(f"interrupted; to go on, {go_on}", file=sys.stderr)
                    raise
                finally:
                    if lost := observer.not_stored:
                        told = f"{len(lost)} flights are not in the store: {lost[0]}; to add them, {go_on}"
                        print(told, file=sys.stderr)
            for line in [*runner.summary_lines(result), f"run: {folder.path}"]:
                print(line, file=sys.stderr)
            status = max(status, runner.EXIT_STATUS[result.verdict])
            if result.verdict == "stopped":
                return status
    if prompts and report:
        from drone_env.llm.paired_report import write_paired_report

        for line in write_paired_report(root, found):
            print(line, file=sys.stderr)
    return status


def _new_folder(runs: Path, model: str, task: str) -> Path:
    name = "".join(letter if letter.isalnum() or letter in ".-_" else "-" for letter in model[:50])
    now = datetime.now(timezone.utc).strftime("%Y%m%d-%H%M%S-%f")
    return runs / f"{now}-{task}-{name}"
