"""``python -m tests.service.page.held PORT DATA``: the service with a fake team that holds jobs.

Every job stays at the stage ``motion`` until the file ``go`` exists in the data folder.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

from planner.batch.job import JobEvent
from planner.service import app
from planner.service.service import Options
from tests.service.support import FakeTeam

DATA = Path(sys.argv[2])


class HeldTeam(FakeTeam):
    """Waits for the file."""

    def events(self, timeout_s: float) -> Iterator[JobEvent]:
        if (DATA / "go").exists():
            self.hold.clear()
        else:
            self.hold.set()
        yield from super().events(timeout_s)


if __name__ == "__main__":
    app.worker_pool_factory = lambda options: HeldTeam  # type: ignore[assignment]
    app.serve(Options(DATA, port=int(sys.argv[1]), examiners=1))
