"""``python -m tests.service.pretend PORT DATA DATABASE [COUNT | tcp://HOST:PORT]``: the service with a team
that takes a moment for each job and makes up the result; with a COUNT, it ends so many jobs, holds the
others, and leaves a file ``held`` beside the data as soon as it holds one. With the address of a scheduler,
workers of that cluster make it up."""

from __future__ import annotations

import functools
import random
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from planner.batch.cluster import Cluster
from planner.batch.job import Event, Finished
from planner.service import app
from planner.service.runner import Team
from planner.service.security import Limits
from planner.service.service import Options
from tests.service import support

LEASE_S = 1.0
MOMENTS = random.Random(5)


class Slow(support.Team):
    """Takes up to a fifth of a second for a job."""

    most: int | None = None
    ended = 0

    def events(self, timeout_s: float) -> Iterator[Event]:
        if self._open:
            time.sleep(MOMENTS.uniform(0.0, 0.2))
        if self.most is not None and self.ended >= self.most:
            self.hold.set()
            if self._open:
                Path(data).with_name("held").touch()
        for event in super().events(timeout_s):
            self.ended += isinstance(event, Finished)
            yield event


if __name__ == "__main__":
    port, data, database, *most = sys.argv[1:]
    cluster = next((one for one in most if one.startswith("tcp://")), None)
    Slow.most = int(most[0]) if most and cluster is None else None
    limits = Limits(open_jobs=10_000, kept_jobs=10_000)
    planned_by: Callable[[], Team] = Slow
    if cluster is not None:
        planned_by = functools.partial(Cluster, cluster, module="tests.batch.faulty_worker")
    app.make_team = lambda options: planned_by  # type: ignore[assignment]
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
