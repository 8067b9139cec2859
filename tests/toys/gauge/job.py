"""Targets and claims of the circle."""

from __future__ import annotations

from typing import Final

import numpy as np

from planner.claims.claim import Claim
from planner.claims.dialogue import OperatorDialogue
from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Severity, TandemError
from planner.processes.poses.claims import FollowsPoses
from planner.targets import Job, ScrewFreedom, Targets
from tests.toys.gauge.claims import KeepsAbove
from tests.toys.gauge.operation import Ring

SPIN: Final = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
"""Twist of the tool about its own axis."""
CHORDS: Final = 36
"""Number of straight moves."""
AMPLE_MM: Final = 1.5
"""Difference of the two heights from which on nothing is reported."""


class RingJob(Job[Ring]):
    """A gauge on a circle."""

    @property
    def _segment(self) -> Segment:
        return Segment("cut", self.operation.name)

    def _around(self, angle: FloatArray) -> FloatArray:
        """Poses (N, 4, 4) in the stock frame, with the tool pointing down."""
        op = self.operation
        pose = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (len(angle), 1, 1))
        pose[:, 0, 3], pose[:, 1, 3] = (op.radius_mm * MM * f for f in (np.cos(angle), np.sin(angle)))
        pose[:, 2, 3] = self.setup.stock.upper[2] + op.height_mm * MM
        return pose

    def targets(self) -> Targets:
        """Make the chords of the circle."""
        op = self.operation
        margin = op.height_mm - op.least_mm
        what = f"{op.name}: the circle is {op.height_mm:g} mm above the block, {op.least_mm:g} mm are needed"
        if margin < 0.0:
            raise TandemError(Issue("ring.height", f"{what}; raise height_mm", field="operations"))
        note = Issue("ring.height", what, Severity.NOTE, value=op.height_mm, limit=op.least_mm, unit="mm")
        (arm,) = op.arms
        pose = self._around(np.linspace(0.0, 2.0 * np.pi, CHORDS + 1))
        count = len(pose)
        stop = np.zeros(count, dtype=np.bool_)
        stop[[0, -1]] = True
        travel = np.linalg.norm(np.diff(pose[:, :3, 3], axis=0, prepend=pose[:1, :3, 3]), axis=1)
        spin = ScrewFreedom("spin", {arm: SPIN}, np.full(count, -60.0 * DEG), np.full(count, 60.0 * DEG))
        return Targets(
            arms=(arm,),
            pose={arm: pose},
            frame={arm: "stock"},
            freedoms=(spin,),
            feed=np.full(count, op.feed_mm_s * MM),
            feed_min=np.zeros(count),
            travel=travel,
            stop=stop,
            segment=(self._segment,) * count,
            claims=self.claims(),
            issues=() if margin > AMPLE_MM else (note,),
        )

    def make_claims(self) -> tuple[Claim, ...]:
        """State that the tool passes twelve places of the circle in order, and how low it may be."""
        (arm,) = self.operation.arms
        places = self._around(np.arange(0.0, 361.0, 30.0) * DEG)
        return (
            FollowsPoses(arm, "stock", places, (SPIN,), 1e-4, 1e-3),
            KeepsAbove(arm, self._segment, self.operation.least_mm * MM),
            OperatorDialogue((arm,)),
        )
