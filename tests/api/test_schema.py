"""Schemathesis checks all responses against the OpenAPI description."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from drone_env.core.tasks import TASKS
from tests.api.networks import put_network
from tests.api.serving import serving

CONFIG = """
hooks = "hooks.py"
[checks]
# A list that is too long can also make the body too large.
negative_data_rejection.expected-statuses = [
    "400", "401", "403", "404", "405", "406", "409", "413", "415", "422", "5xx"
]
"""
HOOKS = """
import schemathesis

@schemathesis.hook
def filter_case(context, case):
    return "x-schemathesis-unknown-property" not in (case.headers or {})
"""
"""Servers ignore unknown headers, which Schemathesis accepts only if the other headers are valid. It takes the header
`x-step-count: 0` for an invalid string, so it reports a 200, which is right if the shared session has no steps."""
EXAMPLES = int(os.environ.get("DRONE_ENV_SCHEMA_EXAMPLES", "1"))
PHASES = ("Examples", "Coverage", "Fuzzing")


@pytest.mark.long
def test_the_api_does_what_its_description_says(tmp_path: Path) -> None:
    (tmp_path / "schemathesis.toml").write_text(CONFIG)
    (tmp_path / "hooks.py").write_text(HOOKS)
    weights = tmp_path / "weights"
    weights.mkdir()
    for task in TASKS.values():
        put_network(task, weights)
    with serving(tmp_path / "data", CAPACITY="100000", WEIGHTS=str(weights)) as server:
        # Made once and then kept; Schemathesis waits for it no longer than 10 s.
        server.client.get("/openapi.json").raise_for_status()
        command = [
            *(sys.executable, "-m", "schemathesis.cli", "run", f"{server.url}/openapi.json"),
            # JSON Schema cannot say "one of both", nor that a grid has as many rows as grid_height says.
            *("--exclude-checks", "positive_data_acceptance"),
            *("--request-timeout", "60", "--max-examples", str(EXAMPLES), "--seed", "1"),
            *("--suppress-health-check", "all", "--no-color", "--phases", ",".join(PHASES).lower()),
        ]
        run = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
        assert run.returncode == 0, run.stdout[-5000:] + run.stderr[-2000:]
        for phase in PHASES:
            assert re.search(rf"✅ +{phase}", run.stdout), run.stdout[-3000:]
        assert "Traceback" not in server.log.read_text()
