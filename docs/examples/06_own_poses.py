"""Use your own poses: two robots measure the thickness of an upright panel, with one gauge on each side.

A pose is a TCP pose in the frame of the block: x and y along its edges from its centre, z up from its bottom.
The z axes of the gauges point at the panel; the planner chooses the rotation about them.
"""

import sys

import numpy as np

import planner
from planner import spec

alone = spec.Cell.read("irb140_gauge")  # a bundled cell: its gauge and its floor
gauge = alone["arms"][0]["tool"]
bases = {"left": spec.Pose(xyz_mm=[-650, 0, 0]), "right": spec.Pose(xyz_mm=[650, 0, 0], rpy_deg=[0, 0, 180])}
arms = [spec.Arm(name=name, robot="irb140", base=base, tool=gauge) for name, base in bases.items()]
cell = spec.Cell(arms=arms, obstacles=alone["obstacles"])

lanes = [[(y, z) for y in (-80, 0, 80)[::turn]] for z, turn in ((60, 1), (120, -1), (180, 1))]
y, z = np.reshape(lanes, (-1, 2)).T
poses = {name: np.tile(np.eye(4), (len(y), 1, 1)) for name in bases}
for pose, side in zip(poses.values(), (-1, 1), strict=True):
    pose[:, :3, :3] = [[0, 0, -side], [0, side, 0], [1, 0, 0]]
    pose[:, :3, 3] = np.stack([np.full(len(y), side * 40.0), y, z], axis=1)  # 30 mm off the panel

stock = spec.Stock(size_mm=[20, 240, 240], place={"xyz_mm": [0, 0, 400]}, support="pedestal")
spins = [spec.FreeAxis(name=f"spin_{name}", arms=[name], axis="z", turn_deg=[-180, 180]) for name in bases]
each = {"stop": [True] * len(y)}
measure = spec.Targets(name="measure", poses=poses, unit="mm", columns=each, free=spins, feed_mm_s=60)
outcome = planner.plan(spec.Problem(name="thickness", cell=cell, stock=stock, operations=[measure]))
outcome.save(sys.argv[1] if len(sys.argv) > 1 else "out_thickness")
print(f"verified: {outcome.verified}, {len(y)} places in {outcome.plan.duration:.1f} s")
