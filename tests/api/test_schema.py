"""Schemathesis over the whole API, all phases: whatever is sent, the answer is what the description says."""

import os
import re
import subprocess
import sys
from pathlib import Path

from drone_env.core.tasks import TASKS
from tests.api.networks import put_network
from tests.api.serving import serving

EXAMPLES = int(os.environ.get("DRONE_ENV_SCHEMA_EXAMPLES", "1"))


def test_the_api_does_what_its_description_says(tmp_path: Path) -> None:
    weights = tmp_path / "weights"
    weights.mkdir()
    for task in TASKS.values():
        put_network(task, weights)
    with serving(tmp_path / "data", CAPACITY="100000", WEIGHTS=str(weights)) as server:
        command = [
            *(sys.executable, "-m", "schemathesis.cli", "run", f"{server.url}/openapi.json"),
            # JSON Schema cannot say "one of both", nor that a grid has as many rows as grid_height says.
            *("--exclude-checks", "positive_data_acceptance"),
            *("--request-timeout", "60", "--max-examples", str(EXAMPLES), "--seed", "1"),
            *("--suppress-health-check", "all", "--no-color"),
        ]
        run = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
        assert run.returncode == 0, run.stdout[-5000:] + run.stderr[-2000:]
        for phase in ("Examples", "Coverage", "Fuzzing", "Stateful"):
            assert re.search(rf"✅ +{phase}", run.stdout), run.stdout[-3000:]
        assert "Traceback" not in server.log.read_text()
