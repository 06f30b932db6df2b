"""`drone-env infer`: a language model flies."""

import contextlib
import dataclasses
import json
import sys
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from drone_env.commands.arguments import ChosenTask, ProfileName, SeedRange, SplitName, select_maps
from drone_env.core.rewards import ORIGINAL_PROFILE, own_profile
from drone_env.core.tasks import custom_task_rules, get_task
from drone_env.envs.registry import register_city
from drone_env.errors import InvalidValueError, needs, text_of
from drone_env.files import RUNS
from drone_env.llm.budget import Budget, OptionalNumber, Options, Whole

if TYPE_CHECKING:
    from drone_env.llm.config import InferenceSettings, RunConfig

PROMPTS = "minimal|grid|coordinates|compass|plan|think|think-plan|original|FILE.toml"
PromptName = Annotated[str, tyro.conf.arg(metavar=PROMPTS)]
Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]


@dataclasses.dataclass(frozen=True)
class RunOptions:
    """The model, the maps, and the run.

    Args:
        task: The task: short name, id or grader. Default: DRONE_TASK.
        model: The model. Default: MODEL_NAME.
        base_url: The endpoint. Default: API_BASE_URL.
        episodes: Number of maps of the split. Default: 1.
        split: Fly the first maps of this split. Default: test.
        seeds: Fly the maps from A up to and not including B instead of a split's.
        repeats: Flights over each map, for pass^k; each sends its own sampling seed.
        prompt: The prompt: name (the newest version), id such as grid-2, or your own file.
        history: Number of last steps that the prompt shows.
        system: Send the system text as a message of its own, or merge it into the first user message, for models
            without a system role.
        answers: Request plain text, structured output (JSON schema), or a tool call.
        reward_profile: Rewards of the steps: a reward profile, or a TOML file with one.
        data: Folder of the store for the flights, which a server shows. Default: DRONE_ENV_DATA, else data. With
            --server, that server stores them.
        out: The run folder. Default: a new folder in llm/ of the data folder.
        resume: Continue the run in --out, under the same configuration.
        report: Verify the whole run and write report.json into its folder.
        moves: Count blunders and other moves in the report, by the exact value of every state.
        allow_plain_http: Send the token over http:// also to a public host, where others can read it.
        use_image: Start the Docker image LOCAL_IMAGE_NAME and repeat every step on its server. Each of its observations
            must equal the one here.
    """

    task: ChosenTask = None
    model: str | None = None
    base_url: str | None = None
    episodes: Whole = None
    split: SplitName = None
    seeds: SeedRange = None
    repeats: int = 1
    prompt: PromptName = "minimal"
    history: int = 0
    system: Literal["role", "merge"] = "role"
    answers: Literal["text", "json", "tool"] = "text"
    reward_profile: ProfileName = ORIGINAL_PROFILE
    data: Path | None = None
    out: Path | None = None
    resume: bool = False
    report: bool = True
    moves: bool = True
    allow_plain_http: Flag = False
    use_image: bool = False


@dataclasses.dataclass(frozen=True)
class SamplingOptions:
    """Parameters of every request.

    Args:
        temperature: Sampling temperature.
        top_p: Nucleus sampling. Default: not sent.
        max_answer_tokens: Maximum length of an answer in tokens, sent as max_tokens; 0 sends none.
        sampling_seed: Sampling seed of the endpoint, plus the number of the repeat: with --repeats 3 and 5, the flights
            over a map send 5, 6 and 7. Default: not sent.
        extra: More fields of the request's body, as a JSON object, such as '{"reasoning_effort": "low"}'.
    """

    temperature: float = 0.0
    top_p: OptionalNumber = None
    max_answer_tokens: int = 1024
    sampling_seed: Whole = None
    extra: str = "{}"


def infer(
    run: Annotated[RunOptions, tyro.conf.arg(name="")],
    sampling: Annotated[SamplingOptions, tyro.conf.arg(name="")],
    options: Annotated[Options, tyro.conf.arg(name="")],
) -> int:
    """Evaluate a language model of any OpenAI-compatible endpoint.

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
        from drone_env.llm.docker_server import running_image
        from drone_env.llm.endpoint import Endpoint
        from drone_env.llm.progress import Progress

    settings = load_settings(run.base_url)
    config = _config(run, sampling, settings)
    token = settings.token_for(config.base_url, run.allow_plain_http)
    if run.use_image and options.server is not None:
        raise InvalidValueError("--use-image starts a server: give it without --server")
    data = data_folder() if run.data is None else run.data
    path = run.out or _new_folder(data / RUNS, config.model, config.task_config.short_name)
    if run.resume and not (path / run_folder.CONFIG).exists():
        raise InvalidValueError(f"there is no run in {path} to resume")
    to_resume = f"give the same options with --out {path} --resume"
    with contextlib.ExitStack() as stack:
        if run.use_image:
            options = dataclasses.replace(options, server=stack.enter_context(running_image(settings.local_image_name)))
        store = None if options.server is not None else stack.enter_context(Store(data))
        stack.enter_context(run_folder.locked_run(path, config, run.resume))
        sender = Endpoint(config.base_url, token, options.timeout)
        progress = Progress(config, Budget(options), path, store)
        try:
            result = asyncio.run(runner.run_flights(config, path, sender, progress))
            if run.report and result.verdict != "stopped":
                reports.write_report(reports.report(reports.verified_run(path), options, run.moves))
        except KeyboardInterrupt:
            print(f"interrupted; to continue, {to_resume}", file=sys.stderr)
            raise
        resume = [] if result.verdict == "valid" else [f"to continue, {to_resume}"]
        print(*runner.summary_lines(result), f"run: {path}", *resume, sep="\n", file=sys.stderr)
        return runner.EXIT_STATUS[result.verdict]


def _config(run: RunOptions, sampling: SamplingOptions, settings: "InferenceSettings") -> "RunConfig":
    from pydantic import ValidationError

    from drone_env.llm.config import RunConfig, Sampling, check_url
    from drone_env.llm.prompt import get_prompt

    split, maps = select_maps(run.seeds, run.split, run.episodes, 1)
    name = settings.drone_task if run.task is None else run.task
    task = register_city(name) if name.endswith(".toml") else get_task(name)
    prompt = get_prompt(run.prompt)
    try:
        return RunConfig(
            model=settings.model_name if run.model is None else run.model,
            base_url=check_url(settings.api_base_url),
            task=task.id,
            task_version=task.version,
            rules=custom_task_rules(task),
            split=split,
            seeds=(maps.start, maps.stop),
            repeats=run.repeats,
            reward_profile=run.reward_profile,
            rewards=own_profile(run.reward_profile),
            prompt=prompt.id,
            prompt_digest=prompt.digest,
            prompt_text=prompt.own,
            history=run.history,
            system=run.system,
            answers=run.answers,
            sampling=Sampling(
                temperature=sampling.temperature,
                top_p=sampling.top_p,
                max_tokens=sampling.max_answer_tokens or None,
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
    now = datetime.now(timezone.utc).strftime("%Y%m%d-%H%M%S-%f")
    return runs / f"{now}-{task}-{name}"
