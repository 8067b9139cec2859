"""A service with a fake team.

Usage: ``python -m tests.service.fake_team PORT DATA DATABASE [COUNT | tcp://HOST:PORT]``. The team takes a
moment for each job and makes up the result. With COUNT, it ends that many jobs, holds the others, and writes
the file ``held`` beside the data as soon as it holds one. With the address of a scheduler, the workers of
that cluster make up the results.
"""

from __future__ import annotations

import functools
import random
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from planner.batch.cluster import ClusterPlanners
from planner.batch.job import JobEvent, JobFinished
from planner.service import app
from planner.service.runner import WorkerPool
from planner.service.security import ServiceLimits
from planner.service.service import Options
from tests.service import support

LEASE_S = 1.0
MOMENTS = random.Random(5)


class SlowTeam(support.FakeTeam):
    """Takes up to a fifth of a second for a job."""

    max_jobs: int | None = None
    ended = 0

    def events(self, timeout_s: float) -> Iterator[JobEvent]:
        if self._open:
            time.sleep(MOMENTS.uniform(0.0, 0.2))
        if self.max_jobs is not None and self.ended >= self.max_jobs:
            self.hold.set()
            if self._open:
                Path(data).with_name("held").touch()
        for event in super().events(timeout_s):
            self.ended += isinstance(event, JobFinished)
            yield event


if __name__ == "__main__":
    port, data, database, *most = sys.argv[1:]
    cluster = next((one for one in most if one.startswith("tcp://")), None)
    SlowTeam.max_jobs = int(most[0]) if most and cluster is None else None
    limits = ServiceLimits(open_jobs=10_000, kept_jobs=10_000)
    planned_by: Callable[[], WorkerPool] = SlowTeam
    if cluster is not None:
        planned_by = functools.partial(ClusterPlanners, cluster, module="tests.batch.faulty_worker")
    app.worker_pool_factory = lambda options: planned_by  # type: ignore[assignment]
    options = Options(
        Path(data),
        port=int(port),
        database=database or None,
        workers=2,
        examiners=1,
        lease_s=LEASE_S,
        limits=limits,
    )
    app.serve(options)
