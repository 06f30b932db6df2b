"""A learner of tianshou, whose buffers take no info that is missing in some steps: `tools/verify.sh adapters`."""

import pytest

from tests.adapters.conftest import run_example


@pytest.mark.timeout(600)
@pytest.mark.filterwarnings("ignore")
def test_the_pages_example_trains_and_its_buffer_has_the_infos(capsys: pytest.CaptureFixture[str]) -> None:
    names = run_example("tianshou")
    flown = names["flown"]
    assert len(flown) == 1_000
    assert set(flown.info.outcome[flown.terminated]) <= {"delivered", "battery_dead", "out_of_steps"}
    assert set(flown.info.outcome[~flown.terminated]) == {"flying"}
    assert 0.01 <= float(capsys.readouterr().out.split()[-1]) < 1
