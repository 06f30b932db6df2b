"""What precedes any work on a cluster: addresses, and nodes with other versions."""

import pytest

from drone_env.cli import main
from drone_env.cluster.ray_engine import VERSIONS, check_node
from drone_env.errors import ClusterError


def test_where_nobody_listens_and_what_is_no_address(capsys: pytest.CaptureFixture[str]) -> None:
    for address in ("127.0.0.1:9", "here", ""):
        assert main(["evaluate", "--task", "easy", "--episodes", "1", "--ray", address]) == 2
        assert "no cluster at" in capsys.readouterr().err


def test_a_node_with_another_package_is_refused() -> None:
    check_node(VERSIONS, ())
    with pytest.raises(ClusterError, match="make them equal"):
        check_node(VERSIONS.replace("drone-env", "drone-env 0.0"), ())
