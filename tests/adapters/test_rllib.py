"""Many drones in RLlib: `tools/verify.sh adapters`."""

from pathlib import Path

import pytest

from drone_env.cluster.ray_engine import connect
from tests.adapters.conftest import run_example


@pytest.mark.timeout(600)
@pytest.mark.filterwarnings("ignore")
def test_the_pages_example_tells_scores(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with connect("local"):
        # RLlib keeps its results here; without Tune it has no option for that.
        monkeypatch.setattr("ray.tune.trainable.trainable.DEFAULT_STORAGE_PATH", str(tmp_path))
        run_example("RLlib")
    scores = [float(line) for line in capsys.readouterr().out.splitlines()[-3:]]
    assert all(0.01 < score < 1 for score in scores)
