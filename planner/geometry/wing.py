"""A wing panel: two airfoil sections in space, joined by rulings.

Its frame: x from the leading to the trailing edge, y from root to tip, z up; the root's leading edge is at
the origin. Sections stand in planes of constant y. The tip is turned about its quarter-chord point.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from planner.geometry.airfoil import SHARP, section_guide, thickened
from planner.geometry.guides import Guide, turned
from planner.geometry.matching import Match, join
from planner.geometry.rulings import resample
from planner.problem import Ruled

FloatArray = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Panel:
    """Lengths [m], angles [rad]. ``root`` and ``tip`` are points (N, 2) per chord, in Selig's order.

    ``sweep`` is that of the quarter-chord line, positive to the rear; ``twist`` is washout, positive with the
    tip's nose down; ``dihedral`` is positive with the tip up. ``trailing_edge``: least thickness there.
    """

    root: FloatArray
    tip: FloatArray
    root_chord: float
    tip_chord: float
    span: float
    sweep: float = 0.0
    twist: float = 0.0
    dihedral: float = 0.0
    trailing_edge: float = 0.0


def skin(panel: Panel, match: Match = "arc_length", tolerance: float = 2e-5) -> Ruled:
    """The panel's closed skin from root to tip, within ``tolerance`` [m] of splines through the sections.

    Leading edges are joined, and trailing edges at the upper and at the lower side, where the skin has a
    corner; between them points at equal shares of each side's length, or as ``match`` says.
    """
    guides = []
    sections = ((panel.root, panel.root_chord), (panel.tip, panel.tip_chord))
    thick = [thickened(points, panel.trailing_edge / chord) for points, chord in sections]
    gaps = [
        float(np.linalg.norm(points[0] - points[-1])) * chord
        for points, (_, chord) in zip(thick, sections, strict=True)
    ]
    for points, (_, chord) in zip(thick, sections, strict=True):
        guides.append(section_guide(points, chord, 0.2 * tolerance, max(gaps) > SHARP))
    root, tip = guides
    quarter = np.array([0.25 * panel.root_chord, 0.0])
    across = quarter + np.array([np.tan(panel.sweep), np.tan(panel.dihedral)]) * panel.span
    start = _placed(root, panel.root_chord, quarter, 0.0, 0.0)
    end = _placed(tip, panel.tip_chord, across, panel.twist, panel.span)
    # over the lower side first: then its direction x the rulings, from root to tip, points outwards
    return resample(join("skin", turned(start), turned(end), match), 0.6 * tolerance, 0.25 * panel.root_chord)


def _placed(guide: Guide, chord: float, quarter: FloatArray, twist: float, y: float) -> Guide:
    """The section with its quarter-chord point at x, z = ``quarter``, nose turned down by ``twist`` [rad]."""
    x, z = guide.points[:, 0] - 0.25 * chord, guide.points[:, 1]
    c, s = np.cos(twist), np.sin(twist)
    placed = np.stack([quarter[0] + c * x - s * z, np.full(len(x), y), quarter[1] + s * x + c * z], axis=1)
    return dataclasses.replace(guide, points=placed)
