"""Many drones in TorchRL: its check, and rollouts beside the environment flown by hand (tools/verify.sh adapters)."""

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from drone_env.envs.wrappers import vector
from tests.adapters.conftest import run_example

N, STEPS = 3, 150
FORMS: dict[str, Any] = {"plain": lambda env: env, "planes": vector.OneHotPlanes, "flat": vector.FlatObservation}
pytestmark = pytest.mark.filterwarnings("ignore")


def make(form: str) -> Any:
    env = gymnasium.make_vec("drone_env:DroneDelivery-Skyline-Easy-v2", num_envs=N, autoreset_mode="DISABLED")
    return FORMS[form](env)


def named(observations: Any) -> list[tuple[str, Any]]:
    """Observations by the names that TorchRL has for them."""
    return [*observations.items()] if isinstance(observations, dict) else [("observation", observations)]


@pytest.mark.parametrize("form", FORMS)
def test_a_rollout_is_what_the_same_actions_fly(form: str) -> None:
    # Here, since its import warns.
    from torchrl.envs import GymWrapper
    from torchrl.envs.utils import check_env_specs

    torch.manual_seed(0)
    env = GymWrapper(make(form))
    check_env_specs(env)
    env.set_seed(5)
    flown = env.rollout(STEPS, break_when_any_done=False).cpu()
    byhand = make(form)
    byhand.reset(seed=5)
    seen, _ = byhand.reset()  # a rollout begins with a reset
    ended = 0
    for step in range(STEPS):
        now = flown[:, step]
        for name, want in named(seen):
            assert np.array_equal(now[name].numpy(), want)
        seen, rewards, over, _, _ = byhand.step(now["action"].argmax(-1).numpy())
        for name, want in named(seen):
            assert np.array_equal(now["next", name].numpy(), want)
        assert np.array_equal(now["next", "reward"][:, 0].numpy(), rewards.astype(np.float32))
        assert np.array_equal(now["next", "terminated"][:, 0].numpy(), over)
        assert np.array_equal(now["next", "done"][:, 0].numpy(), over)
        ended += over.sum()
        if over.any():
            seen, _ = byhand.reset(options={"reset_mask": over})
    assert ended > N


def test_the_pages_example_learns_and_never_bumps(capsys: pytest.CaptureFixture[str]) -> None:
    flights = run_example("TorchRL")["flights"]
    assert flights["action_mask"][flights["action"].bool()].all()
    assert not flights["action_mask"].all()
    losses = [float(line.split()[1]) for line in capsys.readouterr().out.splitlines()]
    assert len(losses) == 3
    assert all(0 < loss < 1 for loss in losses)
