"""Cut a wing panel between two airfoils out of a foam block, with a bow on one robot."""

import sys

import planner
from planner import spec

slab = spec.Box(size_mm=[3200, 2400, 100], pose={"xyz_mm": [0, 0, -50]})
robot = spec.Arm(name="robot", robot="irb140", tool=spec.Bow(span_mm=400, throat_mm=400, tilt_deg=45))
wing = spec.Wing(
    root=spec.Airfoil(naca="2412", chord_mm=140),
    tip=spec.Airfoil(naca="2410", chord_mm=110),
    span_mm=250,
    sweep_deg=4,
    twist_deg=2,
    trailing_edge_mm=1,
)
problem = spec.Problem(
    name="wing",
    cell=spec.Cell(arms=[robot], obstacles=[spec.Obstacle(name="floor", shapes=[slab])]),
    stock=spec.Stock(size_mm=[180, 270, 60], foam="eps_a120", support="pedestal"),
    part=spec.Part(wing=wing),
    operations=[
        spec.StraightWire(
            name="cut",
            arms=["robot"],
            power_w=46,  # over 400 mm of wire; foam, power and speed determine the slot width
            feed_mm_s=6,
            feed_min_mm_s=3,
            shape_tol_mm=0.3,
            cuts=[spec.SurfaceCut(surface="skin")],
        )
    ],
)
outcome = planner.plan(problem)
outcome.save(sys.argv[1] if len(sys.argv) > 1 else "out_wing")
print(f"verified: {outcome.verified}, {outcome.plan.duration:.0f} s, programs: {', '.join(outcome.programs)}")
