"""Convert G-code to KRL: a KUKA robot with a spindle mills a frame around a panel from an .nc file."""

import sys
from pathlib import Path

import planner
from planner import spec

Path("frame.nc").write_text(
    """G21 G90 G17 G94
S18000 M3
G0 X-80 Y-50 Z30
G1 Z-4 F600
G1 X70 F2400
G3 X80 Y-40 I0 J10
G1 Y50
G1 X-80
G1 Y-50
G0 Z30
M5
M30
"""
)
cutter = spec.Mill(diameter_mm=10, flute_mm=40, overhang_mm=60, tilt_deg=90)
code = spec.GCode(file="frame.nc", origin=spec.Pose(xyz_mm=[0, 0, 40]))  # its zero: centre of the top
problem = spec.Problem(
    name="panel_rim",
    cell=spec.Cell.read("kr60_mill").changed("arms.robot.tool", cutter),
    stock=spec.Stock(size_mm=[220, 160, 40], place={"xyz_mm": [1300, 0, 700]}, support="table"),
    operations=[spec.Milling(name="frame", arms=["robot"], cuts=[spec.GCodeCut(name="rim", gcode=code)])],
)
outcome = planner.plan(problem)
outcome.save(sys.argv[1] if len(sys.argv) > 1 else "out_frame")
for name, text in outcome.programs.items():
    print(f"{name}: {len(text.splitlines())} lines")
print(f"verified: {outcome.verified}")
