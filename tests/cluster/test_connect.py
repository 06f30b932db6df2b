"""What stands before any work on a cluster: addresses, Ray itself, nodes that are none of the driver's."""

import pytest

from drone_env.cli import main
from drone_env.cluster.episodes import check_node, node_identity
from drone_env.errors import ClusterError


def test_where_nobody_listens_and_what_is_no_address(capsys: pytest.CaptureFixture[str]) -> None:
    evaluate = ["evaluate", "--task", "easy", "--episodes", "1"]
    for address, said in (("127.0.0.1:9", "no cluster"), ("here", "HOST:PORT"), ("", "HOST:PORT")):
        assert main([*evaluate, "--engine", "ray", "--address", address]) == 2
        assert said in capsys.readouterr().err


def test_a_node_with_another_package_is_refused() -> None:
    identity = node_identity(())
    check_node(identity, ())
    with pytest.raises(ClusterError, match="make them equal"):
        check_node(identity.replace("drone-env", "drone-env 0.0"), ())
