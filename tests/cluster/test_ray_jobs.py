"""Jobs on a Ray cluster: what becomes of one that dies, and of one that raises."""

import os
import signal
from collections.abc import Iterator
from typing import Any

import pytest

from drone_env.cluster.connect import connect
from drone_env.errors import ClusterError, InvalidValueError

pytestmark = [pytest.mark.long, pytest.mark.timeout(300)]


def work(job: str) -> Iterator[str]:
    yield f"{job} began"
    if job == "dies":
        os.kill(os.getpid(), signal.SIGKILL)
    if job == "refuses":
        raise InvalidValueError("no such thing")
    if job == "breaks":
        raise ZeroDivisionError
    yield f"{job} ended"


def test_a_job_that_always_dies_is_given_up_and_the_others_are_done(cluster: Any) -> None:
    from drone_env.cluster.jobs import run_jobs  # imports Ray, which then reads the token of the fixture

    lost: list[tuple[str, str]] = []

    def give_up(job: str, error: Exception) -> None:
        lost.append((job, type(error).__name__))

    with connect(cluster.address):
        brought = list(run_jobs(work, ["dies", "lives"], 2, give_up))
        for job, kind, message in (("refuses", InvalidValueError, "no such"), ("breaks", ClusterError, "ZeroDivision")):
            with pytest.raises(kind, match=message):
                list(run_jobs(work, [job], 2, give_up))
    assert [told for job, told in brought if job == "lives"] == ["lives began", "lives ended"]
    assert lost == [("dies", "WorkerCrashedError")]
