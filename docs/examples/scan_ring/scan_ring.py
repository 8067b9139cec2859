"""Example process: a scanner that points down moves on a circle, 40 mm above the block."""

import numpy as np

from planner.claims import dialogue, segments
from planner.processes import Process
from planner.processes.poses import claims
from planner.reading.strict_yaml import Name, Strict
from planner.targets import Job, Targets


class Ring(Strict):
    name: Name
    process: str
    arms: tuple[str]
    radius_mm: float

    def leaves(self, stock):
        return stock  # the block is unchanged


class RingJob(Job[Ring]):
    def around(self):  # poses (73, 4, 4) in the block's frame, in metres
        turn, height = np.linspace(0, 2 * np.pi, 73), self.setup.stock.upper[2] + 0.04
        ring = self.operation.radius_mm / 1000 * np.column_stack([np.cos(turn), np.sin(turn)])
        return np.array([[[1, 0, 0, x], [0, -1, 0, y], [0, 0, -1, height], [0, 0, 0, 1]] for x, y in ring])

    def targets(self):  # for the arm: poses at 50 mm/s, with stops only at the ends
        arms, ring, feed = self.operation.arms, self.around(), np.full(73, 0.05)
        ends, cut = np.arange(73) % 72 == 0, segments.Segment.of("cut/ring")
        step = np.append(0.0, np.linalg.norm(np.diff(ring[:, :3, 3], axis=0), axis=1))
        return Targets(arms, {arms[0]: ring}, {arms[0]: "stock"}, (), feed, 0 * feed, step, ends, (cut,) * 73)

    def make_claims(self):  # for the proof: requirements
        circle = claims.FollowsPoses(self.operation.arms[0], "stock", self.around(), (), 1e-4, 1e-3)
        return circle, dialogue.OperatorDialogue(self.operation.arms)


PROCESS = Process(schema="scan_ring:Ring", job="scan_ring:RingJob")
