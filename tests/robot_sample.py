"""Sample of the catalogue's robots for tests that need not run on every robot.

It has small and large robots of both makers, with a parallel rod, and with the wrist above, below and in line
with the elbow. Figures are tested for all robots.
"""

from __future__ import annotations

from planner.catalogue.robots import robot

SAMPLE = (
    *("irb140", "irb120", "irb1200_7_70", "irb4400_60", "irb4600_40", "irb6640_185", "irb6700_200"),
    *("kr60_ha", "kr10_r1100", "kr210_r2700"),
)
KUKAS = tuple(name for name in SAMPLE if robot(name).family == "KUKA")
