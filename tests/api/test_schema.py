"""Schemathesis over the whole API, all phases: whatever is sent, the answer is what the description says, and quick."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from drone_env.core.tasks import TASKS
from tests.api.serving import serving

EXAMPLES = int(os.environ.get("DRONE_ENV_SCHEMA_EXAMPLES", "10"))


def test_the_api_does_what_its_description_says(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    from drone_env.rl.export import export_network
    from drone_env.rl.model import PathQNet

    weights = tmp_path / "weights"
    weights.mkdir()
    for task in TASKS.values():
        size = {"telemetry_size": task.telemetry_size}
        export_network(PathQNet(**size), weights / f"{task.id}_v{task.version}.npz", size)
    with serving(tmp_path / "data", CAPACITY="100000", WEIGHTS=str(weights)) as server:
        command = [
            *(sys.executable, "-m", "schemathesis.cli", "run", f"{server.url}/openapi.json"),
            # JSON Schema cannot say "one of both", nor that a grid has as many rows as grid_height says.
            *("--exclude-checks", "positive_data_acceptance"),
            *("--max-response-time", "1", "--request-timeout", "30", "--max-examples", str(EXAMPLES), "--seed", "1"),
            *("--suppress-health-check", "all", "--no-color"),
        ]
        run = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
        assert run.returncode == 0, run.stdout[-5000:] + run.stderr[-2000:]
        for phase in ("Examples", "Coverage", "Fuzzing", "Stateful"):
            assert re.search(rf"✅ +{phase}", run.stdout), run.stdout[-3000:]
        assert "Traceback" not in server.log.read_text()
