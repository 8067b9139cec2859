"""Run a batch: one scan over blocks of several heights, planned by two processes in parallel."""

import sys

import numpy as np

from planner import spec
from planner.batch.run import plan_all

poses = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (3, 1, 1))  # the gauge points down
poses[:, :3, 3] = [[-60, -60, 0], [60, -60, 0], [60, 60, 0]]


def scan(height: float) -> spec.Problem:
    """Return a problem with a block of this height [mm] on a pedestal, scanned 40 mm above its top."""
    above = poses.copy()
    above[:, 2, 3] = height + 40
    return spec.Problem(
        name="scan",
        cell="irb140_gauge",
        stock=spec.Stock(size_mm=[200, 200, height], place={"xyz_mm": [500, 0, 200]}, support="pedestal"),
        operations=[spec.Targets(name="scan", poses={"robot": above}, unit="mm", feed_mm_s=50)],
    )


ended = plan_all(
    {f"block_{h}": scan(h) for h in (60, 120, 900)}, sys.argv[1] if len(sys.argv) > 1 else "out_batch"
)
for name, done in ended.items():
    said = f"{done.metrics['cycle_s']:.1f} s" if done.metrics else done.issues[0].message
    print(f"{name}: {done.state}, {said}")
