"""Claims of the gauge process."""

from __future__ import annotations

import dataclasses
from typing import Final

from planner.claims.claim import Claim
from planner.claims.segments import Segment


@dataclasses.dataclass(frozen=True)
class KeepsAbove(Claim):
    """The TCP of ``arm`` goes through ``segment``, and stays ``height`` [m] or more above the block there."""

    arm: str
    segment: Segment
    height: float


CLAIMS: Final[tuple[type[Claim], ...]] = (KeepsAbove,)
"""Kinds of claims of gauges."""
