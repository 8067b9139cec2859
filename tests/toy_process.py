"""A process as somebody else would add it: a gauge goes round on a circle above the block."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from planner.claims.claim import Claim
from planner.claims.dialogue import OperatorDialogue
from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray
from planner.geometry.units import DEG, MM
from planner.problem import Stock
from planner.processes import Process
from planner.processes.poses.claims import FollowsPoses
from planner.reading.strict_yaml import Name, Strict
from planner.targets import Job, ScrewFreedom, Targets

SPIN = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


class Ring(Strict):
    """A circle of ``radius_mm`` about the middle of the block's top, ``height_mm`` above it."""

    name: Name
    process: Literal["ring"]
    arms: Annotated[tuple[str, ...], Field(min_length=1, max_length=1)]
    radius_mm: Annotated[float, Field(gt=0)]
    height_mm: float
    feed_mm_s: Annotated[float, Field(gt=0)]

    def leaves(self, stock: Stock) -> Stock:
        """The block as it was."""
        return stock


class RingJob(Job[Ring]):
    """The circle as poses and as what must hold."""

    def _around(self, angle: FloatArray) -> FloatArray:
        """Poses (N, 4, 4) in the stock frame, with the tool pointing down."""
        op = self.operation
        pose = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (len(angle), 1, 1))
        pose[:, 0, 3], pose[:, 1, 3] = (op.radius_mm * MM * way for way in (np.cos(angle), np.sin(angle)))
        pose[:, 2, 3] = self.setup.stock.upper[2] + op.height_mm * MM
        return pose

    def targets(self) -> Targets:
        """72 chords of the circle."""
        (arm,) = self.operation.arms
        pose = self._around(np.linspace(0.0, 2.0 * np.pi, 73))
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
            feed=np.full(count, self.operation.feed_mm_s * MM),
            feed_min=np.zeros(count),
            travel=travel,
            stop=stop,
            segment=(Segment.of("cut/ring"),) * count,
            claims=self.claims(),
        )

    def stated(self) -> tuple[Claim, ...]:
        """The tool passes twelve places of the circle in order; its turn about itself is free."""
        (arm,) = self.operation.arms
        places = self._around(np.arange(0.0, 361.0, 30.0) * DEG)
        return (FollowsPoses(arm, "stock", places, (SPIN,), 1e-4, 1e-3), OperatorDialogue((arm,)))


PROCESS = Process("tests.toy_process:Ring", "tests.toy_process:RingJob")


class Unfinished(Strict):
    """An operation that lacks what every one has."""

    name: Name
    process: Literal["ring"]


UNFINISHED = Process("tests.toy_process:Unfinished", "tests.toy_process:RingJob")
