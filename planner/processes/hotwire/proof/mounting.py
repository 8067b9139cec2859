"""When a wire is mounted between two arms."""

from __future__ import annotations

import dataclasses

from planner.processes.hotwire.claims import WireJoins


@dataclasses.dataclass(frozen=True)
class Phase:
    """A wire is mounted: stages ``first`` to ``last``; in the first and last of them the operator mounts it
    and takes it off."""

    first: int
    last: int
    claim: WireJoins
    setup: int = 0
