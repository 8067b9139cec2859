"""The ruled surface that joins the edges of a part's front and back face, and boundaries of meshes."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.guides import CORNER_ANGLE, polyline, turns
from planner.geometry.matching import aligned, join
from planner.geometry.mesh import TriangleMesh
from planner.geometry.rulings import resample
from planner.issues import Issue, Severity
from planner.problem import Ruled

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

NAME: Final = "edges"
_CHORD: Final = 1e-5


def boundaries(mesh: TriangleMesh) -> list[IntArray]:
    """Vertex indices (n,) of every boundary ring, longest first, counterclockwise seen from outside."""
    faces = mesh.faces
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    count = len(mesh.vertices)
    key, back = directed @ np.array([count, 1]), directed @ np.array([1, count])
    rim = directed[~np.isin(key, back)]
    follow = dict(rim.tolist())
    rings = []
    while follow:
        first, at = follow.popitem()
        loop = [first]
        while at != first and at in follow:
            loop.append(at)
            at = follow.pop(at)
        rings.append(np.array(loop, dtype=np.int64))
    return sorted(rings, key=lambda ring: -_length(mesh.vertices[ring]))


def edges(front: TriangleMesh, back: TriangleMesh, same: bool) -> Ruled | Issue:
    """The closed surface from the front's boundary to the back's, named ``edges``, within 0.01 mm.

    ``same``: the back is the front moved, vertex by vertex; otherwise the boundaries are matched by arc
    length between their corners. Where that cannot be, a note says why; nothing but a cut of the edges needs
    them.
    """
    rings = boundaries(front), boundaries(back)
    for name, mine in zip(("front", "back"), rings, strict=True):
        if len(mine) != 1:
            why = f"the {name} face has {len(mine)} boundaries, 1 is wanted"
            return _without(why, "close its holes and leave other pieces out")
    # seen from the front clockwise, so that this direction x the rulings, to the back, points outwards
    first = rings[0][0][::-1]
    if same:
        start, end = front.vertices[first], back.vertices[first]
        corner = (turns(start, True) > CORNER_ANGLE) | (turns(end, True) > CORNER_ANGLE)
        return resample(Ruled(NAME, start, end, corner, closed=True), _CHORD, 1.0)
    guide = polyline(front.vertices[first], closed=True)
    other = polyline(back.vertices[rings[1][0]], closed=True)
    counts = int(guide.corner.sum()), int(other.corner.sum())
    if counts[0] != counts[1]:
        why = f"the front's boundary has {counts[0]} corners and the back's {counts[1]}"
        return _without(why, "give both as many corners")
    guide, other, _ = aligned(guide, other, "arc_length")
    return resample(join(NAME, guide, other), _CHORD, 1.0)


def _without(why: str, do: str) -> Issue:
    what = f"{why}, so the part has no ruled edges that a straight wire could cut; {do} if it should"
    return Issue("part.edges", what, Severity.NOTE, field="part.back")


def _length(points: FloatArray) -> float:
    return float(np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1).sum())
