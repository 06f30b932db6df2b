"""Jobs on the nodes of a cluster: handed out, run again where a worker dies, and what they bring."""

from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator
from itertools import chain, islice
from typing import Any, TypeVar, cast

import ray
from ray.exceptions import RayError, RayTaskError

from drone_env.cluster.nodes import Driver, check_cpus, check_node, this_driver
from drone_env.errors import ClusterError, DroneEnvError

AHEAD = 2
"""Jobs handed out for each that the cluster has CPUs for, so that none waits for the driver."""

Job = TypeVar("Job", bound=Hashable)
Work = Callable[[Any], Iterator[Any]]


def run_jobs(
    work: Work,
    jobs: Iterable[Job],
    tries: int,
    lost: Callable[[Job, RayError], None],
    cpus: int = 1,
    most: int | None = None,
) -> Iterator[tuple[Job, Any]]:
    """Each job with each thing that `work(job)` yields on a node, in the order in which they arrive.

    Inside of `connect` only. A job whose worker dies is run again from its beginning, so a thing may arrive twice.

    Args:
        work: A function of a module that every node has.
        jobs: What to do; no two are equal.
        tries: How often a job is run whose worker dies.
        lost: Called with a job whose worker died on every try, and with the last error.
        cpus: CPUs of one job.
        most: Jobs at a time; as many as there are CPUs for if nothing is said.

    Raises:
        ClusterError: if no node offers the CPUs of a job, a node has another package than this one, or a job fails with
            an error from outside of this package.
        DroneEnvError, OSError: what `work` raises.
    """
    check_cpus(cpus)
    remote: Any = ray.remote(num_cpus=cpus, max_retries=0, num_returns="streaming")(_work_on_node)
    driver, waiting = this_driver(), iter(jobs)
    under_way: dict[Any, Job] = {}
    deaths: Counter[Job] = Counter()
    while True:
        room = most or AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)) // cpus)
        for job in islice(waiting, max(0, room - len(under_way))):
            under_way[remote.remote(driver, work, job)] = job
        if not under_way:
            return
        for stream in cast(Any, ray).wait(list(under_way))[0]:
            job = under_way[stream]
            try:
                brought = cast(Any, ray).get(next(stream))
            except StopIteration:
                del under_way[stream]
                continue
            except RayTaskError as error:
                raise failure(error) from None
            except RayError as error:
                del under_way[stream]
                deaths[job] += 1
                if deaths[job] < tries:
                    waiting = chain([job], waiting)
                else:
                    lost(job, error)
                continue
            yield job, brought


def failure(error: RayTaskError) -> Exception:
    """What went wrong on a node: an error of this package or of its machine as it is, any other as `ClusterError`."""
    cause: Any = error.cause
    return cause if isinstance(cause, (DroneEnvError, OSError)) else ClusterError(f"a node failed: {error}")


def _work_on_node(driver: Driver, work: Work, job: Any) -> Iterator[Any]:
    check_node(driver)
    yield from work(job)
