"""One panel's faces: the surface cut off at its joints and moved onto shapes that the wire takes.

A front and its back have the same vertices in pairs, also those that a cut makes, so that both panels at a
joint have the same rim and the same side between front and back. What is moved onto the wire is moved along
the element's z and so stays in the planes of the joints; how far tells the step at the joint.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from planner.element.misfit import ends_weighted
from planner.geometry.arrays import FloatArray, IntArray, dots
from planner.geometry.mesh import TriangleMesh, vertex_normals
from planner.hotwire.elastic.family import SECTION_POINTS, cut_sections, make_spine
from planner.hotwire.elastica.fit import CurveFit, fit_curves
from planner.hotwire.elastica.heavy import end_sensitivity, from_middle
from planner.hotwire.wire import Wire

ON_A_LINE: Final = 1e-6
"""A vertex nearer to a cut than this [m] is moved onto it."""
SECTION_STEP: Final = 0.02
"""Distance of the sections by which a panel is fitted [m]."""
LEAST_STABILITY: Final = 0.08
"""Margin of stability (1: a free wire, 0: it snaps) that a panel's sections must have."""
TAUT: Final = 0.9997
"""Share of the wire's length beyond which its ends are too far apart."""
CLEAR_ENDS: Final = 0.03
"""How far the wire's ends must be outside of the block [m]."""
_HELD_EVERY = 3  # sections of which one is looked at for that
_SHORTEST_SECTION = 0.5  # of the median: corners that a leaning plane cuts off follow from their neighbours


def clip(values: FloatArray, faces: IntArray, axis: int, at: float, keep: int) -> tuple[FloatArray, IntArray]:
    """What of a mesh lies beyond (``keep`` 1) or before (-1) the plane ``at`` [m] of an ``axis``.

    ``values`` (V, C): coordinates, and whatever else is linear over a facet; ``faces`` (F, 3).
    """
    off = keep * (values[:, axis] - at)
    near = np.abs(off) < ON_A_LINE
    values = values.copy()
    values[near, axis], off[near] = at, 0.0
    sign = np.sign(off).astype(np.int64)[faces]
    has, lacks = (sign > 0).any(axis=1), (sign < 0).any(axis=1)
    cut = faces[has & lacks]
    own = sign[has & lacks]
    # each with the vertex that is alone on its side first
    positive = (own > 0).sum(axis=1)
    alone = np.where(positive == 2, np.argmax(own < 0, axis=1), np.argmax(own > 0, axis=1))
    cut = np.take_along_axis(cut, (alone[:, None] + np.arange(3)) % 3, axis=1)
    own = np.take_along_axis(own, (alone[:, None] + np.arange(3)) % 3, axis=1)
    edges = np.concatenate([cut[:, [0, 1]], cut[:, [0, 2]]])
    crossing = np.concatenate([own[:, 0] * own[:, 1], own[:, 0] * own[:, 2]]) < 0
    pairs, inverse = np.unique(np.sort(edges[crossing], axis=1), axis=0, return_inverse=True)
    a, b = pairs.T
    share = (off[a] / (off[a] - off[b]))[:, None] if len(pairs) else np.zeros((0, 1))
    made = values[a] * (1.0 - share) + values[b] * share
    made[:, axis] = at
    # where the other end lies on the plane, it is the crossing itself
    point = edges[:, 1].copy()
    point[crossing] = len(values) + np.reshape(inverse, -1)
    first, second = np.split(point, 2)
    parts = [faces[has & ~lacks]]
    single = own[:, 0] > 0
    parts.append(np.stack([cut[single, 0], first[single], second[single]], axis=1))
    pair = ~single
    parts.append(np.stack([first[pair], cut[pair, 1], cut[pair, 2]], axis=1))
    parts.append(np.stack([first[pair], cut[pair, 2], second[pair]], axis=1))
    left = np.concatenate(parts)
    used, index = np.unique(left, return_inverse=True)
    return np.concatenate([values, made])[used], np.reshape(index, left.shape).astype(np.int64)


def cut_out(
    front: TriangleMesh, back: TriangleMesh, bounds: tuple[float, float, float, float]
) -> tuple[TriangleMesh, TriangleMesh]:
    """Front and back of the panel over x0, x1, y0, y1 [m], in vertices that belong together."""
    values, faces = np.concatenate([front.vertices, back.vertices], axis=1), front.faces
    for axis, keep, at in ((0, 1, bounds[0]), (0, -1, bounds[1]), (1, 1, bounds[2]), (1, -1, bounds[3])):
        values, faces = clip(values, faces, axis, at, keep)
    return TriangleMesh(values[:, :3], faces), TriangleMesh(values[:, 3:], faces)


@dataclasses.dataclass(frozen=True)
class BentFace:
    """``shift`` (V,): how far [m] each vertex moves along ``up`` onto a shape of the wire; ``off`` (V,): the
    same across the surface; ``misfit``: the largest distance of the sections from the wire [m]; ``held``:
    whether the wire is held safely in these shapes (`_holds`)."""

    shift: FloatArray
    off: FloatArray
    misfit: float
    held: bool


@dataclasses.dataclass(frozen=True)
class CutWire:
    """A wire of one ``length`` [m], of which ``outside`` [m] at least is free of the panel, in all;
    ``end_error`` [m]: how far its ends may be off, and ``moves`` [m]: how far the wire may move by that."""

    wire: Wire
    length: float
    outside: float
    end_error: float
    moves: float


def bend(
    face: TriangleMesh, up: FloatArray, cut: CutWire, half_block: float, end_weight: float
) -> BentFace | None:
    """The shapes of a wire that meet a face in its block's frame, wire along x, swept along y; ``up`` (3,) is
    the element's z there, ``half_block`` [m] half of the block along the wire. None where the wire is too
    short."""
    spine = make_spine(face, np.array([0.0, 1.0, 0.0]), normal=False)
    low, high = face.vertices[:, 1].min(), face.vertices[:, 1].max()
    count = max(9, int(np.ceil((high - low) / SECTION_STEP)) + 1)
    margin = 1e-3 * (high - low)
    sections = cut_sections(face, spine, np.linspace(low + margin, high - margin, count))
    good = sections.length > _SHORTEST_SECTION * np.median(sections.length[sections.length > 0.0])
    points = sections.points[good]
    if sections.length.max() > cut.length - 0.5 * cut.outside:
        return None
    batch = len(points)
    fit = fit_curves(
        points,
        np.full(batch, cut.length),
        np.tile([0.0, -cut.wire.load], (batch, 1)),
        ends_weighted(batch, SECTION_POINTS, end_weight),
    )
    if not np.isfinite(fit.largest).all():
        return None
    flat = np.stack(
        [points[..., 0] + spine.across, np.broadcast_to(sections.p[good][:, None], points.shape[:2])], axis=-1
    )
    known = flat.reshape(-1, 2), fit.residual.reshape(-1)
    wanted = face.vertices[:, :2]
    residual = LinearNDInterpolator(*known)(wanted)
    outside = ~np.isfinite(residual)
    residual[outside] = NearestNDInterpolator(*known)(wanted[outside])
    normal = vertex_normals(face)
    lean = np.hypot(normal[:, 0], normal[:, 2])  # in the plane of the section the way to the wire is longer
    facing = dots(normal, np.broadcast_to(up, normal.shape))
    # residuals are along the section's left normal, which looks up as do fronts
    off = -residual * lean
    shift = off / np.abs(facing)
    return BentFace(shift, off, float(fit.largest.max()), _holds(fit, cut, half_block + abs(spine.across)))


def _holds(fit: CurveFit, cut: CutWire, half_block: float) -> bool:
    """Whether the wire stays in the shapes of a fit: well from snapping, elastic, neither taut nor moved by
    errors of its ends more than is allowed, and its ends clear of the block. The planner asks the same of the
    whole path."""
    some = slice(None, None, _HELD_EVERY)
    length = fit.length[some]
    weight = np.tile([0.0, -cut.wire.load], (len(length), 1))
    shape = from_middle(fit.middle[some], length, weight)
    margin = np.minimum(shape.margin_in_plane, shape.margin_out_of_plane(cut.wire.section))
    if margin.min() < LEAST_STABILITY or np.abs(shape.curvature).max() > cut.wire.max_curvature:
        return False
    first, last = shape.points[:, 0], shape.points[:, -1]
    if (np.linalg.norm(last - first, axis=1) / length).max() > TAUT:
        return False
    if min(float((last[:, 0]).min()), float((-first[:, 0]).min())) < half_block + CLEAR_ENDS:
        return False
    feel = end_sensitivity(shape, fit.foot[some][:, [0, -1]]).ends * cut.end_error
    return bool((feel <= cut.moves).all())
