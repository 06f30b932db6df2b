"""`drone-env infer`: a language model flies."""

import contextlib
import dataclasses
import json
import sys
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from drone_env.commands.arguments import OPTIONAL, ChosenTask, SeedRange, SplitName, select_maps
from drone_env.core.episode import Episode
from drone_env.core.rewards import ORIGINAL_PROFILE
from drone_env.core.tasks import custom_task_rules, get_task
from drone_env.envs.registry import register_city
from drone_env.errors import InvalidValueError, needs, text_of
from drone_env.files import RUNS
from drone_env.llm.budget import Budget, Options, Whole
from drone_env.llm.prompt import get_prompt, prompt_names

if TYPE_CHECKING:
    from drone_env.llm.config import InferenceSettings, RunConfig

PromptName = Annotated[str, tyro.conf.arg(metavar="|".join((*prompt_names(), "FILE.toml")))]


@dataclasses.dataclass(frozen=True)
class RunOptions:
    """The model, the maps, and the run.

    Args:
        task: The task: short name, id or grader. Default: DRONE_TASK.
        local: Evaluate the model in this folder, in this process: that of transformers, or one with a GGUF file.
            --concurrency is the number of flights at once.
        model: The model. Default: MODEL_NAME, or the name of the folder of --local.
        base_url: The endpoint. Default: API_BASE_URL.
        episodes: Number of maps of the split. Default: 1.
        split: Fly the first maps of this split. Default: test.
        seeds: Fly the maps from A up to and not including B instead of a split's.
        repeats: Flights over each map; each sends its own sampling seed.
        prompt: The prompt: name (the newest version), id such as grid-2, or your own file.
        answers: Request plain text, structured output (JSON schema), or a tool call.
        out: The run folder. Default: a new folder in llm/ of the data folder (DRONE_ENV_DATA, else data), whose store
            also gets the flights, so that a server shows them. With --server, that server stores them.
        resume: Continue the run in --out, under the same configuration.
        report: Write report.json into the folder of the run.
        use_image: Start the Docker image LOCAL_IMAGE_NAME and repeat every flight on its server, as with --server.
    """

    task: ChosenTask = None
    local: Path | None = None
    model: str | None = None
    base_url: str | None = None
    episodes: Whole = None
    split: SplitName = None
    seeds: SeedRange = None
    repeats: int = 1
    prompt: PromptName = "minimal"
    answers: Literal["text", "json", "tool"] = "text"
    out: Path | None = None
    resume: bool = False
    report: bool = True
    use_image: bool = False


@dataclasses.dataclass(frozen=True)
class SamplingOptions:
    """Parameters of every request.

    Args:
        temperature: Sampling temperature.
        max_answer_tokens: Maximum length of an answer in tokens, sent as max_tokens; 0 sends none.
        max_completion_tokens: The same limit under the newer name, which counts thoughts too; replaces max_tokens.
        reasoning_effort: How much a reasoning model thinks, such as none, low or high. Default: not sent.
        sampling_seed: Sampling seed of the endpoint, plus the number of the repeat: with --repeats 3 and 5, the flights
            over a map send 5, 6 and 7. Default: not sent.
        extra: More fields of the request's body, as a JSON object, such as '{"top_p": 0.9}'.
    """

    temperature: float = 0.0
    max_answer_tokens: int = 1024
    max_completion_tokens: Whole = None
    reasoning_effort: Annotated[str | None, OPTIONAL] = None
    sampling_seed: Whole = None
    extra: str = "{}"


def infer(
    run: Annotated[RunOptions, tyro.conf.arg(name="")],
    sampling: Annotated[SamplingOptions, tyro.conf.arg(name="")],
    options: Annotated[Options, tyro.conf.arg(name="")],
) -> int:
    """Evaluate a language model of any OpenAI-compatible endpoint, or one in a local folder.

    Standard output contains one [START] line, one [STEP] line per step and one [END] line for each flight, and nothing
    else. HF_TOKEN, OPENAI_API_KEY, API_BASE_URL, MODEL_NAME and DRONE_TASK come from the environment or .env. An
    unusable answer is asked for once more; then the step is a WAIT and is counted. No other policy acts for the model.
    Exit status: 0 for a valid run, 1 if more than 5 % of the flights errored (INVALID), 2 if the endpoint refuses or
    for any other error, 3 if a limit was reached.

    Example: drone-env infer --task easy --episodes 100 --out runs/qwen-easy

    Args:
        run: The model, the maps, and the run.
        sampling: Parameters of every request.
        options: Speed and budget.
    """
    import asyncio

    from drone_env.files import data_folder
    from drone_env.flights.store import Store

    with needs("llm"):
        from drone_env.llm import report as reports
        from drone_env.llm import run_folder, runner
        from drone_env.llm.config import load_settings
        from drone_env.llm.endpoint import Endpoint
        from drone_env.llm.on_server import repeat_on_server, running_image

    settings = load_settings(run.base_url)
    if run.local is not None:
        settings = _local_settings(run, run.local, settings)
    config = _config(run, sampling, settings)
    token = None if run.local is not None else settings.token_for(config.base_url)
    if run.use_image and options.server is not None:
        raise InvalidValueError("--use-image starts a server: give it without --server")
    path = run.out or _new_folder(data_folder() / RUNS, config.model, config.task_config.short_name)
    if run.resume and not (path / run_folder.CONFIG).exists():
        raise InvalidValueError(f"there is no run in {path} to resume")
    to_resume = f"give the same options with --out {path} --resume"
    with contextlib.ExitStack() as stack:
        if run.use_image:
            options = dataclasses.replace(options, server=stack.enter_context(running_image(settings.local_image_name)))
        if options.server is None:
            store = stack.enter_context(Store(data_folder()))
        else:
            store = None  # and its rules must be those here before any call is paid
            first = Episode(config.task_config, ORIGINAL_PROFILE, config.seeds[0])
            repeat_on_server(options.server, first, config.model)
        stack.enter_context(run_folder.locked_run(path, config, run.resume))
        if run.local is None:
            sender = Endpoint(config.base_url, token, options.timeout)
        else:
            from drone_env.llm.local import LocalModel

            sender = LocalModel(run.local, config.base_url.split(":")[1])
        try:
            flown = asyncio.run(runner.Runner(config, path, sender, Budget(options), store).fly())
            verdict, _ = flown.verdict
            if run.report and verdict != "stopped":
                reports.write_report(reports.report(flown))
        except KeyboardInterrupt:
            print(f"interrupted; to continue, {to_resume}", file=sys.stderr)
            raise
        lines = [*runner.summary_lines(flown), f"run: {path}"]
        if verdict != "valid" and not flown.budget.answers:  # a resume has the same options, which may be the reason
            lines.append("nothing was answered: begin a new run, with other options if these are rejected")
        elif verdict != "valid":
            lines.append(f"to continue, {to_resume}{' and a higher limit' if verdict == 'incomplete' else ''}")
        print(*lines, sep="\n", file=sys.stderr)
        return runner.EXIT_STATUS[verdict]


def _local_settings(run: RunOptions, folder: Path, settings: "InferenceSettings") -> "InferenceSettings":
    """The settings with a local model in place of an endpoint."""
    from drone_env.llm.local import best_dtype, model_digest
    from drone_env.llm.run_folder import CONFIG, load_config

    if run.base_url is not None:
        raise InvalidValueError("--local evaluates a model in this process: give it without --base-url")
    if not folder.is_dir():
        raise InvalidValueError(f"--local takes the folder of a model, got {str(folder)!r}")
    dtype = best_dtype()
    if run.resume and run.out is not None and (run.out / CONFIG).exists():
        # Another type could give other answers.
        begun = load_config(run.out).base_url.split(":")
        dtype = begun[1] if begun[0] == "local" else dtype
    name = "-".join(folder.resolve().name.split())
    return settings.model_copy(
        update={"api_base_url": f"local:{dtype}:{model_digest(folder)}", "model_name": run.model or name}
    )


def _config(run: RunOptions, sampling: SamplingOptions, settings: "InferenceSettings") -> "RunConfig":
    from pydantic import ValidationError

    from drone_env.llm.config import RunConfig, Sampling

    split, maps = select_maps(run.seeds, run.split, run.episodes, 1)
    name = settings.drone_task if run.task is None else run.task
    task = register_city(name) if name.endswith(".toml") else get_task(name)
    prompt = get_prompt(run.prompt)
    try:
        return RunConfig(
            model=settings.model_name if run.model is None else run.model,
            base_url=settings.api_base_url,
            task=task.id,
            task_version=task.version,
            rules=custom_task_rules(task),
            split=split,
            seeds=(maps.start, maps.stop),
            repeats=run.repeats,
            prompt=prompt.id,
            prompt_digest=prompt.digest,
            prompt_text=prompt.own,
            answers=run.answers,
            sampling=Sampling(
                temperature=sampling.temperature,
                max_tokens=None if sampling.max_completion_tokens else sampling.max_answer_tokens or None,
                max_completion_tokens=sampling.max_completion_tokens,
                reasoning_effort=sampling.reasoning_effort,
                seed=sampling.sampling_seed,
                extra=json.loads(sampling.extra),
            ),
        )
    except ValidationError as error:
        raise InvalidValueError(text_of(error)) from None
    except (json.JSONDecodeError, RecursionError) as error:
        raise InvalidValueError(f"--extra takes a JSON object: {error}") from None


def _new_folder(runs: Path, model: str, task: str) -> Path:
    name = "".join(letter if letter.isalnum() or letter in ".-_" else "-" for letter in model[:50])
    return runs / f"{datetime.now(timezone.utc):%Y%m%d-%H%M%S-%f}-{task}-{name}"
