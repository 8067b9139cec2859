"""A plan: joint paths on one clock, with what is needed to write programs and reports; saved and loaded
whole.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.issues import Issue
from planner.targets import Targets

FloatArray = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class OperationPlan:
    """The motion of one operation.

    ``targets`` include the transit moves that motion added. ``q`` {arm: (N, 6)} serial joint angles [rad],
    ``values`` (N, F) of the freedoms, ``time`` (N,) [s] from the first target. ``entry`` and ``exit`` {arm:
    (M, 6)} are joint waypoints from home to the first target and from the last one back home; arms run them
    one after the other in the order ``order`` (entry) and its reverse (exit), each with the others standing
    still. ``metrics``: figures by name (costs, margins, clearances, stage times), for reports.
    """

    name: str
    targets: Targets
    q: Mapping[str, FloatArray]
    values: FloatArray
    time: FloatArray
    entry: Mapping[str, FloatArray]
    exit: Mapping[str, FloatArray]
    order: tuple[str, ...]
    metrics: Mapping[str, Any]
    issues: tuple[Issue, ...] = ()


@dataclasses.dataclass(frozen=True)
class Plan:
    """Plans of all operations of a problem. ``places``: the stock's pose (4, 4) in the world in each setup,
    for a held block the pose about which its holder moves it; ``bases`` {arm: (4, 4)} are in the world.
    """

    problem_name: str
    digest: str
    versions: Mapping[str, str]
    places: tuple[FloatArray, ...]
    bases: Mapping[str, FloatArray]
    operations: tuple[OperationPlan, ...]
    metrics: Mapping[str, Any]
    issues: tuple[Issue, ...] = ()

    @property
    def stock_pose(self) -> FloatArray:
        """The stock's pose (4, 4) in the first setup."""
        return self.places[0]
