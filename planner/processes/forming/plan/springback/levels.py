"""What the loop from level to level needs of a forecast, as the data of its file (`planner.loops.loop_plan`).

Each loop of the path is a level. Its points are the places nearest to the control points of the next level
that has some, and others between, so that force is measured all around; curves are mixed of the levels with
control points above and below, and along their rings, as `PassSpringback.at` mixes springback.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray
from planner.geometry.curves import along, arc_length
from planner.geometry.units import MM
from planner.processes.forming.plan.contact import Pass, ToolPath
from planner.processes.forming.plan.level import first_loops
from planner.processes.forming.plan.process_plan import Work
from planner.processes.forming.plan.sheet_mechanics import OF_SCALLOP
from planner.processes.forming.plan.springback.compensation import Way, at_targets
from planner.processes.forming.plan.springback.curves import PassSpringback

FORCE_EXPONENT: Final = 2.0 * OF_SCALLOP
"""Exponent of the force in the step: scallops grow with its square."""
SPACING: Final = 1.0 * MM
"""Way [m] between places of a level, as far as their number allows."""
PLACES: Final = (24, 240)
"""Places of a level at least and at most."""
POINTS: Final = 48
"""Points of a level at least."""
SHARES: Final = np.array([0.0, 0.1, 0.25, 0.46, 0.7, 1.0])
"""Forces of a curve over its largest one."""


def file_data(
    name: str, digest: str, work: Work, laid: Sequence[tuple[Pass, ToolPath]], found: Sequence[PassSpringback]
) -> dict[str, Any]:
    """The file of a problem by its ``name`` and ``digest``; passes with their levels."""
    passes = []
    for (one, path), springback in zip(laid, found, strict=True):
        if np.isnan(springback.springback).any():
            continue  # a sheet that snaps has no curve to correct by
        radius = work.heads[work.former(one)].radius
        passes.append(
            {
                "name": one.name,
                "side": one.side,
                "ball_radius_mm": radius / MM,
                "force_exponent": FORCE_EXPONENT,
                "levels": _levels(work, one, path, springback),
            }
        )
    return {"tandem_loop": 1, "problem": name, "digest": digest, "passes": passes}


def _levels(work: Work, one: Pass, path: ToolPath, found: PassSpringback) -> list[dict[str, Any]]:
    contact, out = path.contact, []
    mix = _Mixed(found)
    for number in first_loops(one, contact):
        points = contact.point[contact.loop == number]
        depth = abs(float(points[:, 2].mean()) - one.start)
        ring = evenly(points)
        place = _places(ring, found)
        loads, springback, force = mix.at(ring[place])
        if work.stated is not None:
            force = work.stated.at(one.name, ring[place])
        out.append(
            {
                "depth_mm": round(depth / MM, 4),
                "path_mm": np.round(ring / MM, 3).tolist(),
                "points": [
                    {
                        "place": int(at),
                        "forces_n": np.round(n, 2).tolist(),
                        "springback_mm": np.round(s / MM, 4).tolist(),
                        "expected_n": round(float(f), 2),
                    }
                    for at, n, s, f in zip(place, loads, springback, force, strict=True)
                ],
            }
        )
    return out


def evenly(points: FloatArray) -> FloatArray:
    """A closed loop of points (N, 3) [m] as places (K, 3) that are equally far apart."""
    return along(np.vstack([points, points[:1]]), *_even(points))


def _even(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Way [m] to each point of a closed loop and back (N + 1,), and to its even places (K,)."""
    way = arc_length(np.vstack([points, points[:1]]))
    count = int(np.clip(round(float(way[-1]) / SPACING), *PLACES))
    return way, np.arange(count) * way[-1] / count


def shifts(one: Pass, path: ToolPath, way: Way) -> list[FloatArray]:
    """What a springback file shifts the tools by, (K,) [m] at the places of each level of a pass; ``path`` is
    the one without it."""
    contact, shift, out = path.contact, at_targets(way, path), []
    for number in first_loops(one, contact):
        mine = contact.loop == number
        gone, at = _even(contact.point[mine])
        out.append(np.interp(at, gone, np.append(shift[mine], shift[mine][0])))
    return out


def _places(ring: FloatArray, found: PassSpringback) -> IntArray:
    """Places (P,) of a level's points, rising."""
    control = found.control
    height = np.array([float(one.point[:, 2].mean()) for one in control.rings])
    nearest = int(np.abs(height - float(ring[:, 2].mean())).argmin())
    some = control.point[control.level == nearest]
    own = np.unique(cKDTree(ring[:, :2]).query(some[:, :2])[1])
    count = len(ring)
    gaps = np.diff(np.append(own, own[0] + count))
    rows = [
        np.floor(start + gap * np.arange(parts) / parts)
        for start, gap in zip(own, gaps, strict=True)
        for parts in [max(1, int(np.ceil(gap * POINTS / count - 1e-9)))]
    ]
    return np.unique(np.concatenate(rows).astype(np.int64) % count)


class _Mixed:
    """Curves between control points."""

    def __init__(self, found: PassSpringback) -> None:
        control = found.control
        self._rings = control.rings
        self._height = np.array([float(ring.point[:, 2].mean()) for ring in control.rings])
        top = np.array([curve.force[-1] for curve in found.curves])
        value = np.array([curve.at(SHARES * n) for curve, n in zip(found.curves, top, strict=True)])
        # what is mixed of each control point: its largest force, the springback at shares of it, the expected
        self._rows = np.column_stack([top, value, found.force])
        self._level, self._place = control.level, control.place

    def at(self, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Forces (P, L) [N] and springback (P, L) [m] of the curves at places (P, 3) [m] of one level, and
        the force (P,) [N] that is expected."""
        z, order = float(points[:, 2].mean()), np.argsort(self._height)
        height = self._height[order]
        above = int(np.clip(np.searchsorted(height, z), min(1, len(height) - 1), len(height) - 1))
        below = max(above - 1, 0)
        rise = height[above] - height[below]
        share = float(np.clip((z - height[below]) / rise, 0.0, 1.0)) if rise > 0.0 else 0.0
        low, high = (self._on_ring(int(order[k]), points) for k in (below, above))
        rows = (1.0 - share) * low + share * high
        return rows[:, :1] * SHARES, rows[:, 1:-1], rows[:, -1]

    def _on_ring(self, level: int, points: FloatArray) -> FloatArray:
        ring, mine = self._rings[level].point, self._level == level
        at = cKDTree(ring[:, :2]).query(points[:, :2])[1]
        place, rows = self._place[mine].astype(np.float64), self._rows[mine]
        return np.stack([np.interp(at, place, row, period=float(len(ring))) for row in rows.T], axis=1)
