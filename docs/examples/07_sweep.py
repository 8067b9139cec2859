"""Sweep a value: how far from the robot should the block stand? Plans each distance and draws the margins."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import planner
from planner import spec

lanes = [[x, y, 120] for y, turn in ((-60, 1), (0, -1), (60, 1)) for x in (-80 * turn, 80 * turn)]
poses = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (len(lanes), 1, 1))  # points down
poses[:, :3, 3] = lanes
scan = spec.Targets(
    name="scan",
    poses={"robot": poses},
    unit="mm",
    feed_mm_s=60,
    free=[spec.FreeAxis(name="spin", arms=["robot"], axis="z", turn_deg=[-180, 180])],
)
stock = spec.Stock(size_mm=[200, 160, 80], place={"xyz_mm": [500, 0, 200]}, support="pedestal")
near = {"clearance_mm": 5}
problem = spec.Problem(name="scan", cell="irb140_gauge", stock=stock, operations=[scan], settings=near)
margins = {}
for x in range(300, 701, 80):
    try:
        proof = planner.plan(problem.changed("stock.place.xyz_mm", [x, 0, 200])).proof
        margins[x] = [proof.rule(f"verify.{name}").worst for name in ("joint_limits", "singularity")]
        print(f"{x} mm: {margins[x][0]:.0f} deg from a limit, {margins[x][1]:.0f} deg from a singularity")
    except planner.TandemError as error:
        print(f"{x} mm: {error.issues[0].message}")

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out_sweep")
folder.mkdir(parents=True, exist_ok=True)
lines = plt.plot(list(margins), list(margins.values()), marker="o")
plt.legend(lines, ["joint limits", "singularities"])
plt.gca().set(xlabel="distance of the block [mm]", ylabel="least margin [deg]")
plt.savefig(folder / "sweep.svg")
