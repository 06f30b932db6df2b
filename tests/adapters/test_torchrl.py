"""Many drones in TorchRL: its check, and the page's example: `tools/verify.sh adapters`."""

from typing import Any

import gymnasium
import pytest

from drone_env.envs.wrappers import vector
from tests.adapters.conftest import run_example

FORMS: dict[str, Any] = {"plain": lambda env: env, "planes": vector.OneHotPlanes, "flat": vector.FlatObservation}
pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.mark.parametrize("form", FORMS)
def test_torchrls_check_passes(form: str) -> None:
    # Here, since its import warns.
    from torchrl.envs import GymWrapper
    from torchrl.envs.utils import check_env_specs

    env = gymnasium.make_vec("drone_env:DroneDelivery-Skyline-Easy-v2", num_envs=3, autoreset_mode="DISABLED")
    check_env_specs(GymWrapper(FORMS[form](env)))


def test_the_pages_example_learns_and_never_bumps(capsys: pytest.CaptureFixture[str]) -> None:
    flights = run_example("TorchRL")["flights"]
    assert flights["action_mask"][flights["action"].bool()].all()
    assert not flights["action_mask"].all()
    losses = [float(line.split()[1]) for line in capsys.readouterr().out.splitlines()]
    assert len(losses) == 3
    assert all(0 < loss < 1 for loss in losses)
