"""Planar outlines that are cut through a plate: which lies in which, and what is wrong with them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from shapely import LinearRing, MultiPoint, Polygon, STRtree
from shapely.ops import nearest_points
from shapely.validation import explain_validity

from planner.issues import Issue
from planner.units import MM

FloatArray = NDArray[np.float64]

SAME: Final = 1e-5
"""Outlines [m] that are this near touch each other; all along, they are the same one."""


@dataclasses.dataclass(frozen=True)
class Outline:
    """A closed outline (N, 2) [m], counterclockwise; ``depth`` counts the outlines around it.

    Those of odd depth are holes. ``corner`` (N,) marks its corners.
    """

    points: FloatArray
    corner: NDArray[np.bool_]
    depth: int = 0
    inside: int | None = None

    @property
    def hole(self) -> bool:
        """Whether the part lies around it."""
        return self.depth % 2 == 1


def check(rings: Sequence[FloatArray], names: Sequence[str]) -> list[Issue]:
    """Issues of closed rings (N, 2): crossing themselves, given twice, crossing or touching each other.

    ``names`` are the fields of the issues.
    """
    issues = []
    polygons = [Polygon(ring) for ring in rings]
    sound = []
    for polygon, ring, name in zip(polygons, rings, names, strict=True):
        if LinearRing(ring).is_simple and polygon.is_valid:
            sound.append(True)
            continue
        sound.append(False)
        where = explain_validity(polygon)
        place = where[where.find("[") + 1 : where.find("]")].split() if "[" in where else []
        at = f" near ({', '.join(f'{float(v) / MM:.2f}' for v in place[:2])}) mm" if place else ""
        what = f"the outline crosses or touches itself{at}; correct it there"
        issues.append(Issue("part.outline_crossing", what, field=name))
    tree = STRtree(polygons)
    for i, polygon in enumerate(polygons):
        for j in sorted(int(k) for k in tree.query(polygon, predicate="dwithin", distance=SAME) if k > i):
            if not (sound[i] and sound[j]):
                continue
            other = polygons[j]
            alike = np.abs(np.subtract(polygon.bounds, other.bounds)).max() < SAME
            if alike and polygon.exterior.hausdorff_distance(other.exterior) < SAME:
                what = f"is the same outline as {names[i]}; leave one out"
                issues.append(Issue("part.outline_duplicate", what, field=names[j]))
            elif polygon.exterior.dwithin(other.exterior, SAME):
                meet = nearest_points(polygon.exterior, other.exterior)[0]
                what = f"crosses or touches {names[i]} near ({meet.x / MM:.2f}, {meet.y / MM:.2f}) mm; "
                what += "outlines must "
                what += "lie apart or one in the other, so move or join them"
                issues.append(Issue("part.outline_overlap", what, field=names[j]))
    return issues


def sides(points: FloatArray) -> tuple[float, float]:
    """Long and short side [m] of the smallest rectangle, turned as it likes, around points (K, 2) [m]."""
    around = MultiPoint(np.asarray(points)).minimum_rotated_rectangle
    if around.geom_type != "Polygon":  # all on one line, or at one place
        return float(around.length), 0.0
    one, other = np.linalg.norm(np.diff(np.asarray(around.exterior.coords), axis=0), axis=1)[:2].tolist()
    return max(one, other), min(one, other)


def nested(rings: Sequence[FloatArray], corners: Sequence[NDArray[np.bool_]]) -> list[Outline]:
    """The rings, counterclockwise, with their depth, in the order in which they may be cut: the inmost first,
    each hole before the outline around it, and otherwise as they are given.

    They must be free of the faults that :func:`check` finds. ``inside`` is the index, in the list returned,
    of the outline next around.
    """
    polygons = [Polygon(ring) for ring in rings]
    inner, outer = STRtree(polygons).query(polygons, predicate="within")
    within = np.zeros((len(rings), len(rings)), dtype=np.bool_)
    within[inner, outer] = inner != outer
    depth = within.sum(axis=1)
    order = sorted(range(len(rings)), key=lambda i: -int(depth[i]))
    out = []
    for i in order:
        around = [j for j in np.flatnonzero(within[i]) if depth[j] == depth[i] - 1]
        inside = order.index(int(around[0])) if around else None
        turned = not polygons[i].exterior.is_ccw
        points = rings[i][::-1] if turned else rings[i]
        corner = corners[i][::-1] if turned else corners[i]
        out.append(Outline(points, corner, int(depth[i]), inside))
    return out
