"""What stands before any work on a cluster: addresses, Ray itself, nodes that are none of the driver's."""

import dataclasses

import pytest

from drone_env.cli import main
from drone_env.cluster.nodes import check_node, failure, this_driver
from drone_env.errors import ClusterError, InvalidValueError


def test_where_nobody_listens_and_what_is_no_address(capsys: pytest.CaptureFixture[str]) -> None:
    evaluate = ["evaluate", "--task", "easy", "--episodes", "1"]
    for address, said in (("127.0.0.1:9", "no cluster"), ("here", "HOST:PORT"), ("", "HOST:PORT")):
        assert main([*evaluate, "--engine", "ray", "--address", address]) == 2
        assert said in capsys.readouterr().err


def test_a_node_with_another_package_is_refused() -> None:
    driver = this_driver()
    check_node(driver)
    with pytest.raises(ClusterError, match="make them equal"):
        check_node(dataclasses.replace(driver, identity=driver.identity.replace("drone-env", "drone-env 0.0")))


def test_errors_of_a_node_keep_their_kind_if_they_are_ours() -> None:
    from ray.exceptions import RayTaskError

    for cause, kind in ((InvalidValueError("no such thing"), InvalidValueError), (ZeroDivisionError(), ClusterError)):
        assert isinstance(failure(RayTaskError("fly", "traceback", cause)), kind)
