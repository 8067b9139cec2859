"""Form a cone out of a clamped aluminium sheet, with a ball tool on one robot; the part is a trimesh."""

import sys

import numpy as np
import trimesh

import planner
from planner import spec

# cone height over the radius; the mean of shifted cones has rounded edges that the ball can reach
radius = np.linspace(52, 0, 105)
height = np.mean([np.interp(radius + shift, [26, 40], [-12, 0]) for shift in np.linspace(-5, 5, 41)], axis=0)
cone = trimesh.creation.revolve(np.stack([radius, height], axis=1), sections=120)

ball = spec.BallTool(radius_mm=6, length_mm=200)
robot = spec.Arm(name="robot", robot="irb4600_40", tool=ball, home_deg=[0, -20, 20, 0, 60, 0])
slab = spec.Box(size_mm=[7000, 5000, 100], pose={"xyz_mm": [0, 0, -60]})
sheet = spec.Sheet(
    size_mm=[220, 220],
    thickness_mm=0.8,
    metal="aa1100_o",
    opening_mm=150,
    clamp=spec.Clamp(width_mm=30, above_mm=10, below_mm=60),
)
problem = spec.Problem(
    name="cone",
    cell=spec.Cell(arms=[robot], obstacles=[spec.Obstacle(name="floor", shapes=[slab])]),
    sheet=sheet,
    part=spec.Part(sheet_mesh=spec.SheetMesh(file=cone, unit="mm", face="bottom")),
    operations=[spec.Forming(name="cone", arms=["robot"], mode="spif", stepdown_mm=1, feed_mm_s=25)],
)
outcome = planner.plan(problem)
outcome.save(sys.argv[1] if len(sys.argv) > 1 else "out_cone")
formed = outcome.proof.rule("verify.formed")
print(f"verified: {outcome.verified}, {outcome.plan.duration:.0f} s; {formed.worst} {formed.unit}")
