"""Cut a panel with two curved faces with an elastic wire between two robots; its front is a numpy surface.

The wire keeps its length, and bends to the required shape of each line across the panel.
"""

import sys

import numpy as np

import planner
from planner import spec

x, y = np.meshgrid(np.linspace(-80, 80, 33), np.linspace(-90, 90, 37), indexing="ij")
z = 55 + 12 * (1 - (x / 80) ** 2) - 6 * (y / 90) ** 2  # arched from left to right, lower at both ends
front = spec.FaceMesh(file=np.stack([x, y, z], axis=-1), unit="mm")  # a grid (33, 37, 3): its normals are up
problem = spec.Problem(
    name="wire_panel",
    cell="two_irb140_facing",
    stock=spec.Stock(size_mm=[160, 180, 90], support="pedestal"),
    part=spec.Part(front=spec.Front(mesh=front), back=spec.Back(offset_mm=20)),
    operations=[
        spec.ElasticWire(
            name="faces",
            arms=["left", "right"],
            wire=spec.Wire(material="spring_steel", diameter_mm=1.5, length_mm=520, temperature_c=300),
            kerf_mm=2.5,
            feed_mm_s=8,
            shape_tol_mm=0.8,
        )
    ],
)
outcome = planner.plan(problem)
outcome.save(sys.argv[1] if len(sys.argv) > 1 else "out_wire_panel")
surface = outcome.proof.rule("verify.surface")
print(f"verified: {outcome.verified}; {surface.worst:.1f} {surface.unit}, asked 0.8 mm")
