"""``python -m tests.service.pretend PORT DATA DATABASE``: the service with a team that takes a moment for
each job and makes up the result."""

from __future__ import annotations

import random
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from planner.batch.job import Event
from planner.service import serve
from planner.service.limits import Limits
from planner.service.service import Options
from tests.service.support import Team

LEASE_S = 1.0
MOMENTS = random.Random(5)


class Slow(Team):
    """Takes up to a fifth of a second for a job."""

    def events(self, timeout_s: float) -> Iterator[Event]:
        if self._open:
            time.sleep(MOMENTS.uniform(0.0, 0.2))
        yield from super().events(timeout_s)


if __name__ == "__main__":
    port, data, database = sys.argv[1:]
    limits = Limits(open_jobs=10_000, kept_jobs=10_000)
    serve.make_team = lambda options: Slow  # type: ignore[assignment]
    options = Options(
        Path(data), port=int(port), database=database or None, workers=2, lease_s=LEASE_S, limits=limits
    )
    serve.serve(options)
