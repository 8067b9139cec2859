"""One panel's faces: the surface cut off at its joints and moved onto shapes that the wire takes.

A front and its back have the same vertices in pairs, also those that a cut makes, so that both panels at a
joint have the same rim and the same side between front and back. What is moved onto the wire is moved along
the element's z and so stays in the planes of the joints; how far tells the step at the joint.
"""

import dataclasses
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.geometry.mesh import TriangleMesh, vertex_normals
from planner.processes.hotwire.plan.elastic.family import (
    FamilyFit,
    cut_sections,
    fit_family,
    fit_first,
    make_spine,
    section_places,
)
from planner.processes.hotwire.plan.elastica.fit import CurveFit
from planner.processes.hotwire.plan.elastica.heavy import HeavyShape, end_sensitivity, from_middle
from planner.processes.hotwire.plan.wire import Wire

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
_COLUMNS = 161  # across a face, between which what sections say is linear
_HELD_EVERY = 3  # sections of which one is looked at for that
_LEAST_SECTIONS, _MOST_SECTIONS = 8, 100  # steps between the ends of a face, but for those near them
_KNOT_STEP = 0.045  # m between knots of the family's spline
_CELLS = 16, 32  # of it
_BESIDE = 0.04  # m: the wires of a face go on beyond it as far as jobs ask it with their usual margin


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
    found = cut_sections(
        face, spine, section_places(low, high, SECTION_STEP, _LEAST_SECTIONS, _MOST_SECTIONS)
    )
    sections = found.take(np.flatnonzero(found.length > 0.0))
    if sections.length.max() > cut.length - 0.5 * cut.outside:
        return None
    across = sections.points[..., 0] + spine.across
    if (np.diff(across, axis=1) <= 0.0).any():
        return None
    load = np.tile([0.0, -cut.wire.load], (len(across), 1))
    fit = fit_family(
        sections,
        fit_first(sections, load, cut.length),
        load,
        cut.length,
        low - _BESIDE,
        high + _BESIDE,
        -spine.across,
        int(np.clip(np.ceil((high - low + 2.0 * _BESIDE) / _KNOT_STEP), *_CELLS)),
        end_weight,
    )
    if not np.isfinite(fit.residual).all():
        return None
    residual = _between(sections.p, across, fit.residual, face.vertices[:, :2])
    normal = vertex_normals(face)
    lean = np.hypot(normal[:, 0], normal[:, 2])  # in the plane of the section the way to the wire is longer
    facing = dots(normal, np.broadcast_to(up, normal.shape))
    # residuals are along the section's left normal, which looks up as do fronts
    off = -residual * lean
    shift = off / np.abs(facing)
    held = _held_in_block(fit, sections.p, cut, half_block + abs(spine.across))
    return BentFace(shift, off, float(np.abs(fit.residual).max()), held)


def _between(places: FloatArray, across: FloatArray, values: FloatArray, wanted: FloatArray) -> FloatArray:
    """Values (V,) at points ``wanted`` (V, 2), between those that sections at y ``places`` (K,), rising, have
    at x ``across`` (K, M), rising.

    Beyond the ends of a section they are those of the nearest section that reaches as far: its own end says
    nothing of the wire there. Beyond the outer sections they are as there."""
    x = np.linspace(across.min(), across.max(), _COLUMNS)
    level = np.stack([np.interp(x, *one) for one in zip(across, values, strict=True)])
    beyond = 0.5 * (x[1] - x[0])
    inside = (x >= across[:, :1] - beyond) & (x <= across[:, -1:] + beyond)
    rows = np.arange(len(places))[:, None]
    reaching = np.where(inside, rows, -1)
    before = np.maximum.accumulate(reaching, axis=0)
    after = np.minimum.accumulate(np.where(inside, rows, len(places))[::-1], axis=0)[::-1]
    nearest = np.where(before >= 0, before, np.minimum(after, len(places) - 1))
    level = np.take_along_axis(level, nearest, axis=0)
    share = np.clip((wanted[:, 0] - x[0]) / (x[-1] - x[0]), 0.0, 1.0) * (_COLUMNS - 1)
    left = np.minimum(share.astype(np.int64), _COLUMNS - 2)
    first = np.clip(np.searchsorted(places, wanted[:, 1]) - 1, 0, len(places) - 2)
    up = np.clip((wanted[:, 1] - places[first]) / (places[first + 1] - places[first]), 0.0, 1.0)
    right = share - left
    lower = level[first, left] * (1.0 - right) + level[first, left + 1] * right
    upper = level[first + 1, left] * (1.0 - right) + level[first + 1, left + 1] * right
    return np.asarray(lower + up * (upper - lower))


def holds(fit: CurveFit, cut: CutWire) -> BoolArray:
    """Whether the wire stays in the shapes (B,) of a fit: well from snapping, elastic, neither taut nor moved
    by errors of its ends more than is allowed. The planner asks the same of the whole path."""
    return _stays(_shapes(fit.middle, cut), fit.foot, cut)


def _shapes(middle: FloatArray, cut: CutWire) -> HeavyShape:
    count = len(middle)
    return from_middle(middle, np.full(count, cut.length), np.tile([0.0, -cut.wire.load], (count, 1)))


def _stays(shape: HeavyShape, foot: FloatArray, cut: CutWire) -> BoolArray:
    margin = np.minimum(shape.margin_in_plane, shape.margin_out_of_plane(cut.wire.section))
    bent = np.abs(shape.curvature).max(axis=1)
    apart = np.linalg.norm(shape.points[:, -1] - shape.points[:, 0], axis=1) / shape.length
    feel = end_sensitivity(shape, foot[:, [0, -1]]).ends * cut.end_error
    good = (margin >= LEAST_STABILITY) & (bent <= cut.wire.max_curvature) & (apart <= TAUT)
    return np.asarray(good & (feel <= cut.moves))


def _held_in_block(fit: FamilyFit, places: FloatArray, cut: CutWire, half_block: float) -> bool:
    """Whether the wire stays in the shapes of a panel's fit at ``places`` (K,) (`holds`), its ends clear of
    the block."""
    some = slice(None, None, _HELD_EVERY)
    shape = _shapes(fit.family.state(places[some]), cut)
    ends = min(float(shape.points[:, -1, 0].min()), float(-shape.points[:, 0, 0].max()))
    return ends >= half_block + CLEAR_ENDS and bool(_stays(shape, fit.foot[some], cut).all())
