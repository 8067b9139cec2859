"""An arm with seven axes as the proof sees it, by the text of its URDF: it stands in a cell in which others
work. No language is written for such arms, so no program moves one.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from planner.catalogue.robots import SevenParameters
from planner.geometry.arrays import FloatArray
from planner.verify.replay import parallel_arm

_ABOUT: Final = (2, 1, 2, 1, 2, 1, 2)
"""Axes of the links, by number, about which the joints turn."""


def differences(planned: SevenParameters, zero: FloatArray, axis: FloatArray, most: float) -> Iterator[str]:
    """Where axes and tip of a chain are not as planned, as :func:`parallel_arm.lines_apart` says it."""
    p = planned
    steps = (
        (0.0, 0.0, 0.0),
        (0.0, 0.0, p.c1),
        (0.0, 0.0, 0.0),
        (p.a2, 0.0, p.c2),
        (p.a3, 0.0, p.c3),
        (0.0, 0.0, 0.0),
        (p.a4, 0.0, 0.0),
    )
    return parallel_arm.lines_apart(p, _ABOUT, steps, parallel_arm.moved(0.0, 0.0, p.c4), zero, axis, most)
