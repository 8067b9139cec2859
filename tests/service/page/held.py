"""``python -m tests.service.page.held PORT DATA``: the service with a team that holds every job at the stage
``motion`` until there is a file ``go`` in the data folder."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

from planner.batch.job import Event
from planner.service import app
from planner.service.service import Options
from tests.service.support import Team

DATA = Path(sys.argv[2])


class Held(Team):
    """Waits for the file."""

    def events(self, timeout_s: float) -> Iterator[Event]:
        if (DATA / "go").exists():
            self.hold.clear()
        else:
            self.hold.set()
        yield from super().events(timeout_s)


if __name__ == "__main__":
    app.make_team = lambda options: Held  # type: ignore[assignment]
    app.serve(Options(DATA, port=int(sys.argv[1]), examiners=1))
