"""One panel's faces: the surface cut off at its joints and moved onto shapes that the wire takes.

A front and its back have the same vertices in pairs, also those that a cut makes, so that both panels at a
joint have the same rim and the same side between front and back. What is moved onto the wire is moved along
the element's z and so stays in the planes of the joints; how far tells the step at the joint.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np

from planner.element.misfit import ends_weighted
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.geometry.mesh import TriangleMesh, vertex_normals
from planner.hotwire.elastic.family import SECTION_POINTS, cut_sections, make_spine
from planner.hotwire.elastica.fit import CurveFit, fit_curves
from planner.hotwire.elastica.heavy import HeavyShape, end_sensitivity, from_middle
from planner.hotwire.wire import Wire

ON_A_LINE: Final = 1e-6
"""A vertex nearer to a cut than this [m] is moved onto it."""
SECTION_STEP: Final = 0.02
"""Distance of the sections by which a panel is fitted [m]."""
LEAST_STABILITY: Final = 0.08
"""Margin of stability (1: a free wire, 0: it snaps) that a panel's sections must have."""
TAUT: Final = 0.9997
"""Share of the wire's length beyond which its ends are too far apart."""
CLEAR_ENDS: Final = 0.05
"""How far the wire's ends must be outside of the block [m] for it to be held safely: jobs ask 20 mm of all of
the path, which comes 15 mm nearer between the sections looked at, and holders stand there."""
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
    whether the wire is held safely in these shapes (`holds`) with its ends clear of the block."""

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
    short or a section turns back over itself."""
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
    across = points[..., 0] + spine.across
    if (np.diff(across, axis=1) <= 0.0).any():
        return None
    residual = _between(sections.p[good], across, fit.residual, face.vertices[:, :2])
    normal = vertex_normals(face)
    lean = np.hypot(normal[:, 0], normal[:, 2])  # in the plane of the section the way to the wire is longer
    facing = dots(normal, np.broadcast_to(up, normal.shape))
    # residuals are along the section's left normal, which looks up as do fronts
    off = -residual * lean
    shift = off / np.abs(facing)
    return BentFace(
        shift, off, float(fit.largest.max()), _held_in_block(fit, cut, half_block + abs(spine.across))
    )


def _between(places: FloatArray, across: FloatArray, values: FloatArray, wanted: FloatArray) -> FloatArray:
    """Values (V,) at points ``wanted`` (V, 2), between those that sections at y ``places`` (K,), rising, have
    at x ``across`` (K, M), rising; beyond the ends of a section, and the outer sections, those there."""
    x, y = wanted.T
    first = np.clip(np.searchsorted(places, y) - 1, 0, len(places) - 2)
    share = np.clip((y - places[first]) / (places[first + 1] - places[first]), 0.0, 1.0)
    out = np.zeros(len(wanted))
    for k in range(len(places) - 1):
        rows = np.flatnonzero(first == k)
        one, other = (np.interp(x[rows], across[i], values[i]) for i in (k, k + 1))
        out[rows] = one + share[rows] * (other - one)
    return out


def holds(fit: CurveFit, cut: CutWire) -> BoolArray:
    """Whether the wire stays in the shapes (B,) of a fit: well from snapping, elastic, neither taut nor moved
    by errors of its ends more than is allowed. The planner asks the same of the whole path."""
    return _stays(_shapes(fit, cut, slice(None)), fit.foot, cut)


def _shapes(fit: CurveFit, cut: CutWire, some: slice) -> HeavyShape:
    length = fit.length[some]
    return from_middle(fit.middle[some], length, np.tile([0.0, -cut.wire.load], (len(length), 1)))


def _stays(shape: HeavyShape, foot: FloatArray, cut: CutWire) -> BoolArray:
    margin = np.minimum(shape.margin_in_plane, shape.margin_out_of_plane(cut.wire.section))
    bent = np.abs(shape.curvature).max(axis=1)
    apart = np.linalg.norm(shape.points[:, -1] - shape.points[:, 0], axis=1) / shape.length
    feel = end_sensitivity(shape, foot[:, [0, -1]]).ends * cut.end_error
    good = (margin >= LEAST_STABILITY) & (bent <= cut.wire.max_curvature) & (apart <= TAUT)
    return np.asarray(good & (feel <= cut.moves))


def _held_in_block(fit: CurveFit, cut: CutWire, half_block: float) -> bool:
    """Whether the wire stays in the shapes of a panel's fit (`holds`), its ends clear of the block."""
    some = slice(None, None, _HELD_EVERY)
    shape = _shapes(fit, cut, some)
    ends = min(float(shape.points[:, -1, 0].min()), float(-shape.points[:, 0, 0].max()))
    return ends >= half_block + CLEAR_ENDS and bool(_stays(shape, fit.foot[some], cut).all())
