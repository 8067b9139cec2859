"""Cut a drum that is wider at its foot: one robot holds and rotates the block, the other cuts with a bow."""

import sys

import numpy as np

import planner
from planner import spec

around = np.linspace(0, 2 * np.pi, 72, endpoint=False)
circle = np.stack([np.cos(around), np.sin(around), np.zeros(72)], axis=1)
tools = {"left": spec.Bow(tilt_deg=45), "right": spec.GripperPlate(width_mm=80, depth_mm=80)}
places = {"left": {"xyz_mm": [-700, 0, 0]}, "right": {"xyz_mm": [700, 0, 0], "rpy_deg": [0, 0, 180]}}
arms = [spec.Arm(name=name, robot="irb140", base=places[name], tool=tools[name]) for name in tools]
slab = spec.Box(size_mm=[3200, 2400, 100], pose={"xyz_mm": [0, 0, -50]})

side = spec.Ruled(
    name="side",
    closed=True,
    start=spec.Guide(polyline_mm=85 * circle),
    end=spec.Guide(polyline_mm=70 * circle + [0, 0, 120]),
    match="parameter",
)
cut = spec.StraightWire(
    name="drum",
    arms=["left", "right"],
    power_w=48,
    feed_mm_s=6,
    feed_min_mm_s=3,
    shape_tol_mm=0.3,
    step_mm=12,
    cuts=[spec.SurfaceCut(surface="side")],
)
stock = spec.Stock(size_mm=[200, 200, 120], foam="eps_a120", held_by="right")
part = spec.Part(ruled=[side], in_stock={})
cell = spec.Cell(arms=arms, obstacles=[spec.Obstacle(name="floor", shapes=[slab])])
outcome = planner.plan(spec.Problem(name="drum", cell=cell, stock=stock, part=part, operations=[cut]))
outcome.save(sys.argv[1] if len(sys.argv) > 1 else "out_drum")
print(f"verified: {outcome.verified}, cut in {outcome.plan.duration:.0f} s by {len(outcome.programs)} files")
