"""The table of features: what was promised, by id, and whether its tests pass. `pytest --features` prints it.

A test speaks for a feature by its mark: `@pytest.mark.feature("E1")`.
"""

import pytest
from rich.console import Console
from rich.markup import escape
from rich.table import Table

FEATURES = {
    "E1": "Maps are generated from a seed or a PyTorch generator: the same one gives the same map",
    "E2": "A city of seven cell types; each has an emoji, a name and an effect, and the legend tells them",
    "E3": "UP, DOWN, LEFT, RIGHT and WAIT; a move off the grid is penalised and the drone stays",
    "E4": "A DroneObservation has 21 typed fields, from the emoji grid to the legend, documented in OpenAPI",
    "E5": "DroneAction, DroneObservation and DroneState are Pydantic models; a state has the path_history",
    "E6": "Three tasks, easy_delivery, medium_delivery and hard_delivery, with the numbers of the specification",
    "E7": "A step pays base + 0.05 per cell nearer to the target, between 0.01 and 0.99; profiles tiered and composite",
    "E8": "Each step drains the battery and an empty one ends the flight; buildings, trees and obstacles are noticed",
    "E9": "Graders easy, medium and hard score a DroneState or its dictionary, from 0.01 to 0.99, by one formula",
    "E10": "DroneDeliveryEnvironment is an OpenEnv Environment, and OpenEnv's own client flies it",
    "L1": "PathQNet: a convolutional map encoder and a dense head with LayerNorm, for maps of any size",
    "L2": "Telemetry: x/width, y/height, battery, target x/width, target y/height",
    "L3": "EpsilonGreedyPolicy decays linearly, 1.0 to 0.05 in 5000 steps; the training loop by 0.995 per episode",
    "L4": "python train.py --task TASK --episodes N [--gpu] trains a DQN; the preset original has the first numbers",
    "L5": "A checkpoint every 50 episodes in data/easy.pth; training goes on from it, and anew where it was deleted",
    "L6": "data/train.log grows while it trains, /logs shows it; data/memory.json holds the last 100 episodes",
    "L7": "POST /predict tells the next action of the trained network, on a fresh install",
    "H1": "POST /reset starts an episode of a task on the map of a seed, and answers a DroneObservation",
    "H2": "POST /step flies one action and answers a DroneObservation",
    "H3": "GET /state tells the full DroneState of the session's episode",
    "H4": "GET /grade/{task_name} grades the session's episode",
    "H5": "GET /analyse/{task_name} sums up the stored history: reward, success, trend, steps, deliveries, actions",
    "H6": "GET /path_history tells the episode's trajectory, step by step",
    "H7": "GET /memory_logs tells the last 5 finished episodes",
    "H8": "GET /logs tells the last 50 lines of the training log, data/train.log",
    "H9": "GET /terminal_logs tells the HTTP requests: as JSON, or live as server-sent events",
    "H10": "GET /tasks and GET /graders tell the tasks with their numbers, and the graders",
    "H11": "GET /health says that the server is healthy, and its version",
    "H12": "GET / is the dashboard, and all its files are there",
    "H13": "uv run server, python -m uvicorn server.app:app, python drone_env/server/app.py each start it",
    "H14": "DroneEnvClient drives it from Python, and python -m drone_env.client URL flies a smoke mission",
    "I1": "HF_TOKEN, OPENAI_API_KEY, API_BASE_URL, MODEL_NAME, DRONE_TASK, LOCAL_IMAGE_NAME, from environment or .env",
    "I2": "python inference.py prints [START], [STEP] and [END] lines and nothing else; success is all delivered",
    "I3": "The prompt names role, goal, actions, asks for one uppercase word; tells battery, target, distance",
    "D1": "Live map and telemetry; reset, start, pause, single steps of the neural network; request and training logs",
    "D2": "Results on success and on failure, under the map, with efficiency: 75 % parcels, 15 % battery, 10 % steps",
    "D3": "Next leads on from Easy to Medium to Hard, and to Easy again",
    "D4": "Technical specifications: the three levels side by side, sizes and rewards as /tasks tells them",
    "D5": "The results show the analysis of all flights so far: mean reward, success trend, how often each action",
    "P1": "openenv.yaml names app, port, tasks and graders, and openenv validate passes",
    "P2": "A Dockerfile of two stages with a HEALTHCHECK on port 8000; each build is recorded in data/docker_build.log",
    "P3": "validate-submission.sh URL [DIR] checks Space, docker build and openenv validate: All 3/3 checks passed!",
    "P4": "python check_graders.py finds, calls and checks the graders of the manifest",
    "P5": 'pyproject.toml and uv.lock agree: uv sync and pip install -e ".[dev]" install what is needed',
    "P6": "pytest runs tests/test_env.py and tests/test_api.py, and tells how much of the code they cover",
    "P7": "The MIT licence, a guide for contributors, and one for pushing to the Hugging Face Hub",
}
"""What each feature promises: environment, learning, HTTP server, inference, dashboard, delivery."""
STYLES = {"passed": "green", "failed": "bold red", "skipped": "yellow", "missing": "bold red"}


class FeatureTable:
    """Keeps what became of each feature, prints the table, and fails the run where one has no test.

    A feature with several tests has passed when all of them have.
    """

    def __init__(self) -> None:
        self.outcomes: dict[str, str] = {}
        self.reasons: dict[str, str] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note one phase of one test: its own, or a set-up or tear-down that did not pass."""
        if report.when != "call" and report.passed:
            return
        for feature in (str(value) for name, value in report.user_properties if name == "feature"):
            if self.outcomes.get(feature, "passed") == "passed" or report.failed:
                self.outcomes[feature] = report.outcome
                self.reasons[feature] = "" if report.passed else reason_of(report)

    def missing(self) -> list[str]:
        """The promised features that no test has spoken for."""
        return [feature for feature in FEATURES if feature not in self.outcomes]

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """A feature without a test fails the run."""
        if self.missing() and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self) -> None:
        """Print it."""
        table = Table("id", "feature", "result", title="Features", title_justify="left")
        for feature, text in FEATURES.items():
            outcome = self.outcomes.get(feature, "missing")
            reason = self.reasons.get(feature, "no test is marked with it")
            table.add_row(feature, escape(text), f"[{STYLES[outcome]}]{outcome}[/]" + (f": {reason}" if reason else ""))
        console = Console(width=None if Console().is_terminal else 150)
        console.print()
        console.print(table)
        console.print(f"{list(self.outcomes.values()).count('passed')} of {len(FEATURES)} features pass")


def reason_of(report: pytest.TestReport) -> str:
    """Why a test failed or was skipped, in a line."""
    if isinstance(report.longrepr, tuple):
        return escape(report.longrepr[2].removeprefix("Skipped: "))
    crash = getattr(report.longrepr, "reprcrash", None)
    return escape(str(report.longrepr if crash is None else crash.message).splitlines()[0])
