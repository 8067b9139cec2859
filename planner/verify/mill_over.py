"""How a cutter passes over a face with its end: how far it is off the face, beyond its edge, and leant."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from planner.claims_milling import MillsOver
from planner.tooling import Cutter
from planner.verify.mill_laid import Laid

FloatArray = NDArray[np.float64]

ROUNDS = 4
"""Times that the contact is looked for anew, with the normal of the place that was found."""
BESIDE = 1.5e-3
"""Normals of places so far around count, too: over a crease the tool turns from the one to the other."""
UPRIGHT = 1e-3


def within(corners: FloatArray, margin: float) -> shapely.Geometry:
    """What triangles (F, 3, 3) cover in plan [m], without the strip ``margin`` [m] wide along its edge."""
    flat = corners[..., :2]
    one, two = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    upright = one[:, 0] * two[:, 1] == one[:, 1] * two[:, 0]
    whole = shapely.union_all(shapely.polygons(flat[~upright]))
    return shapely.buffer(whole, -margin, join_style="mitre") if margin else whole


class OverFace:
    """A face that is milled with the end of a cutter."""

    def __init__(self, claim: MillsOver) -> None:
        self._claim = claim
        self._face = Laid(claim.vertices, claim.faces)
        self._area = within(self._face.corners, claim.margin)
        shapely.prepare(self._area)

    def off(self, tip: FloatArray, axis: FloatArray) -> dict[str, FloatArray]:
        """How far (T,) the samples ``tip``, ``axis`` (T, 3) are off, by what is asked: 1 is allowed."""
        claim = self._claim
        beyond, gap, normal = self._touching(tip, axis)
        if claim.upright:
            lean = _angle(axis, np.array([0.0, 0.0, 1.0]))
        else:
            steps = BESIDE * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
            around = [self._face.at(self._inside(tip[:, :2] + step)).normal for step in steps]
            lean = np.nanmin([_angle(axis, own) for own in (normal, *around)], axis=0)
        # from line to line a tool that leans along its feed turns over, and its edge swings up
        flat, tube = claim.cutter.radius - claim.cutter.corner, claim.cutter.corner
        swing = flat * np.sin(claim.lean) + tube * (1.0 - np.cos(claim.lean))
        allowed = claim.tolerance + beyond + np.where(gap > 0.0, swing, 0.0)
        return {
            "off the face": np.abs(gap) / allowed,
            "beyond the edge of what is to be milled": beyond / (claim.cutter.radius + claim.tolerance),
            "leant too far": lean / (claim.turn + (0.0 if claim.upright else claim.lean)),
        }

    def _touching(self, tip: FloatArray, axis: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Where the end of the cutter is nearest to the face: how far beyond the edge (T,) [m], how far above
        or below the face (T,) [m], and the normal (T, 3) there."""
        normal = self._face.at(self._inside(tip[:, :2])).normal
        far = np.full(len(tip), np.inf)
        found = [far, far, normal]
        for rim in (0.0, 1.0):
            own = normal
            for _ in range(ROUNDS):
                contact = _contact(tip, axis, own, self._claim.cutter, rim)
                inside = self._inside(contact[:, :2])
                place = self._face.at(inside)
                own = np.where(np.isfinite(place.normal), place.normal, own)
            beyond = np.linalg.norm(inside - contact[:, :2], axis=1)
            gap = ((contact - place.point) * own).sum(axis=1)
            better = np.abs(gap) < np.abs(found[1])
            found = [
                np.where(better, beyond, found[0]),
                np.where(better, gap, found[1]),
                np.where(better[:, None], own, found[2]),
            ]
            if self._claim.cutter.radius == self._claim.cutter.corner:
                break
        return found[0], found[1], found[2]

    def _inside(self, xy: FloatArray) -> FloatArray:
        """Places (T, 2), those beyond the edge moved to the nearest place within."""
        out = xy.copy()
        rows = np.flatnonzero(~shapely.contains_xy(self._area, xy[:, 0], xy[:, 1]))
        if len(rows):
            nearest = shapely.shortest_line(self._area, shapely.points(xy[rows]))
            out[rows] = shapely.get_coordinates(shapely.get_point(nearest, 0))
        return out


def _contact(tip: FloatArray, axis: FloatArray, normal: FloatArray, cutter: Cutter, rim: float) -> FloatArray:
    """The places (T, 3) of a cutter's end that touch a plane with ``normal`` (T, 3): up the axis to the
    height of the round edge's tube, out to it by ``rim`` of the way, and down along the normal."""
    out = (normal * axis).sum(axis=1, keepdims=True) * axis - normal
    size = np.linalg.norm(out, axis=1, keepdims=True)
    outward = np.where(size > UPRIGHT, out / np.maximum(size, 1e-12), 0.0)
    return np.asarray(tip + cutter.corner * (axis - normal) + rim * (cutter.radius - cutter.corner) * outward)


def _angle(axis: FloatArray, other: FloatArray) -> FloatArray:
    chord = np.linalg.norm(axis - other, axis=1)
    return np.asarray(2.0 * np.arcsin(np.clip(0.5 * chord, 0.0, 1.0)))
