"""Faces of one panel: the surface cut off at its joints and projected onto shapes that the wire takes.

A front and its back have the same vertices in pairs, including those that a cut creates, so that both panels
at a joint have the same rim and the same side between front and back. Vertices move onto the wire along the
element's z, so they stay in the planes of the joints; the displacement determines the step at the joint.
"""

import dataclasses
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.geometry.mesh import TriangleMesh, vertex_normals
from planner.processes.hotwire.plan.elastic.family import (
    FamilyExtent,
    FamilyFit,
    SectionWire,
    cut_sections,
    fit_family,
    fit_single_sections,
    make_spine,
    section_positions,
)
from planner.processes.hotwire.plan.elastica.fit import CurveFit
from planner.processes.hotwire.plan.elastica.heavy import HeavyShape, end_sensitivity, from_middle
from planner.processes.hotwire.plan.wire import HeatedWire

SNAP_TOLERANCE_M: Final = 1e-6
"""Distance [m] from a cut within which a vertex is moved onto it."""
SECTION_STEP_M: Final = 0.02
"""Distance of the sections by which a panel is fitted [m]."""
MIN_STABILITY: Final = 0.08
"""Minimum stability margin (1: a free wire, 0: it snaps) of the sections of a panel."""
MAX_CHORD_RATIO: Final = 0.9997
"""Maximum distance of the wire's ends as a fraction of its length."""
END_CLEARANCE_M: Final = 0.05
"""Minimum distance [m] of the wire's ends from the block for it to be held safely.

Jobs require 20 mm on the whole path, which comes 15 mm nearer between the checked sections, and holders need
space.
"""
_COLUMNS = 161  # across a face; values are linear between them
_HELD_STRIDE = 3  # every how many sections are checked for that
_MIN_SECTIONS, _MAX_SECTIONS = 8, 100  # steps between the ends of a face, without those close to them
_KNOT_STEP_M = 0.045  # m between knots of the family's spline
_CELL_RANGE = 16, 32  # of it
_EXTENSION_M = 0.04  # m: extension of wires beyond a face, as jobs require with their default margin


def clip(values: FloatArray, faces: IntArray, axis: int, at: float, keep: int) -> tuple[FloatArray, IntArray]:
    """Clip a mesh at a plane.

    Args:
        values: Coordinates and other values that are linear over a facet (V, C).
        faces: Facets (F, 3).
        axis: Axis across the plane.
        at: Position of the plane on the axis [m].
        keep: 1 to keep what is beyond the plane, -1 for what is before it.
    """
    distance = keep * (values[:, axis] - at)
    is_on_plane = np.abs(distance) < SNAP_TOLERANCE_M
    values = values.copy()
    values[is_on_plane, axis], distance[is_on_plane] = at, 0.0
    sign = np.sign(distance).astype(np.int64)[faces]
    has, lacks = (sign > 0).any(axis=1), (sign < 0).any(axis=1)
    cut = faces[has & lacks]
    signs = sign[has & lacks]
    # rotate each facet so that the vertex alone on its side is first
    positive = (signs > 0).sum(axis=1)
    alone = np.where(positive == 2, np.argmax(signs < 0, axis=1), np.argmax(signs > 0, axis=1))
    cut = np.take_along_axis(cut, (alone[:, None] + np.arange(3)) % 3, axis=1)
    signs = np.take_along_axis(signs, (alone[:, None] + np.arange(3)) % 3, axis=1)
    edges = np.concatenate([cut[:, [0, 1]], cut[:, [0, 2]]])
    crossing = np.concatenate([signs[:, 0] * signs[:, 1], signs[:, 0] * signs[:, 2]]) < 0
    pairs, inverse = np.unique(np.sort(edges[crossing], axis=1), axis=0, return_inverse=True)
    a, b = pairs.T
    fraction = (distance[a] / (distance[a] - distance[b]))[:, None] if len(pairs) else np.zeros((0, 1))
    new_values = values[a] * (1.0 - fraction) + values[b] * fraction
    new_values[:, axis] = at
    # an end on the plane is the crossing itself
    point = edges[:, 1].copy()
    point[crossing] = len(values) + np.reshape(inverse, -1)
    first, second = np.split(point, 2)
    parts = [faces[has & ~lacks]]
    single = signs[:, 0] > 0
    parts.append(np.stack([cut[single, 0], first[single], second[single]], axis=1))
    pair = ~single
    parts.append(np.stack([first[pair], cut[pair, 1], cut[pair, 2]], axis=1))
    parts.append(np.stack([first[pair], cut[pair, 2], second[pair]], axis=1))
    left = np.concatenate(parts)
    used, index = np.unique(left, return_inverse=True)
    return np.concatenate([values, new_values])[used], np.reshape(index, left.shape).astype(np.int64)


def cut_out(
    front: TriangleMesh, back: TriangleMesh, bounds: tuple[float, float, float, float]
) -> tuple[TriangleMesh, TriangleMesh]:
    """Return front and back of the panel over x0, x1, y0, y1 [m], with paired vertices."""
    values, faces = np.concatenate([front.vertices, back.vertices], axis=1), front.faces
    for axis, keep, at in ((0, 1, bounds[0]), (0, -1, bounds[1]), (1, 1, bounds[2]), (1, -1, bounds[3])):
        values, faces = clip(values, faces, axis, at, keep)
    return TriangleMesh(values[:, :3], faces), TriangleMesh(values[:, 3:], faces)


@dataclasses.dataclass(frozen=True)
class BentFace:
    """Projection of a face onto shapes of the wire.

    Attributes:
        shift: Displacement (V,) [m] of each vertex along ``up``.
        deviation: Displacement (V,) [m] across the surface.
        misfit: Maximum distance [m] of the sections from the wire.
        held: Whether the wire is held safely in these shapes (`is_held`) with its ends clear of the block.
    """

    shift: FloatArray
    deviation: FloatArray
    misfit: float
    held: bool


@dataclasses.dataclass(frozen=True)
class CutWire:
    """A wire of one length.

    Attributes:
        wire: Wire.
        length: Length [m].
        outside: Minimum total length [m] outside of the panel.
        end_error: Position error [m] of its ends.
        max_displacement: Maximum displacement [m] of the wire by that error.
    """

    wire: HeatedWire
    length: float
    outside: float
    end_error: float
    max_displacement: float


def bend_face(
    face: TriangleMesh, up: FloatArray, cut: CutWire, half_block: float, end_weight: float
) -> BentFace | None:
    """Fit shapes of a wire to a face in the frame of its block, wire along x, swept along y.

    None if the wire is too short or a section turns back over itself.

    Args:
        face: Face.
        up: Direction (3,) of the element's z in the block frame.
        cut: Wire.
        half_block: Half of the block along the wire [m].
        end_weight: Weight of the ends of sections in the fit.
    """
    spine = make_spine(face, np.array([0.0, 1.0, 0.0]), normal=False)
    low, high = face.vertices[:, 1].min(), face.vertices[:, 1].max()
    sections_found = cut_sections(
        face, spine, section_positions(low, high, SECTION_STEP_M, _MIN_SECTIONS, _MAX_SECTIONS)
    )
    sections = sections_found.select(np.flatnonzero(sections_found.length > 0.0))
    if sections.length.max() > cut.length - 0.5 * cut.outside:
        return None
    across = sections.points[..., 0] + spine.across
    if (np.diff(across, axis=1) <= 0.0).any():
        return None
    wire = SectionWire(
        load=np.tile([0.0, -cut.wire.load_over_stiffness], (len(across), 1)), length=cut.length
    )
    fit = fit_family(
        sections,
        fit_single_sections(sections, wire),
        wire,
        FamilyExtent(lower=low - _EXTENSION_M, upper=high + _EXTENSION_M, centre=-spine.across),
        int(np.clip(np.ceil((high - low + 2.0 * _EXTENSION_M) / _KNOT_STEP_M), *_CELL_RANGE)),
        end_weight,
    )
    if not np.isfinite(fit.residual).all():
        return None
    residual = _interpolate(sections.p, across, fit.residual, face.vertices[:, :2])
    normal = vertex_normals(face)
    normal_fraction = np.hypot(normal[:, 0], normal[:, 2])  # the distance in the section plane is longer
    facing = dots(normal, np.broadcast_to(up, normal.shape))
    # residuals are along the left normal of the section, which points up, as fronts do
    deviation = -residual * normal_fraction
    shift = deviation / np.abs(facing)
    held = _is_held_in_block(fit, sections.p, cut, half_block + abs(spine.across))
    return BentFace(shift, deviation, float(np.abs(fit.residual).max()), held)


def _interpolate(
    positions: FloatArray, across: FloatArray, values: FloatArray, points: FloatArray
) -> FloatArray:
    """Interpolate values (V,) at points (V, 2) between those of sections.

    Beyond the ends of a section the nearest section that reaches as far is used, because the end of a section
    says nothing about the wire there. Beyond the outer sections their values are used.

    Args:
        positions: Positions of sections in y (K,), ascending.
        across: Positions of values in x (K, M), ascending.
        values: Values (K, M).
        points: Points (V, 2).
    """
    x = np.linspace(across.min(), across.max(), _COLUMNS)
    level = np.stack([np.interp(x, *row_values) for row_values in zip(across, values, strict=True)])
    beyond = 0.5 * (x[1] - x[0])
    inside = (x >= across[:, :1] - beyond) & (x <= across[:, -1:] + beyond)
    rows = np.arange(len(positions))[:, None]
    reaching = np.where(inside, rows, -1)
    previous = np.maximum.accumulate(reaching, axis=0)
    following = np.minimum.accumulate(np.where(inside, rows, len(positions))[::-1], axis=0)[::-1]
    nearest = np.where(previous >= 0, previous, np.minimum(following, len(positions) - 1))
    level = np.take_along_axis(level, nearest, axis=0)
    fraction = np.clip((points[:, 0] - x[0]) / (x[-1] - x[0]), 0.0, 1.0) * (_COLUMNS - 1)
    left = np.minimum(fraction.astype(np.int64), _COLUMNS - 2)
    first = np.clip(np.searchsorted(positions, points[:, 1]) - 1, 0, len(positions) - 2)
    up = np.clip((points[:, 1] - positions[first]) / (positions[first + 1] - positions[first]), 0.0, 1.0)
    right = fraction - left
    lower = level[first, left] * (1.0 - right) + level[first, left + 1] * right
    upper = level[first + 1, left] * (1.0 - right) + level[first + 1, left + 1] * right
    return np.asarray(lower + up * (upper - lower))


def is_held(fit: CurveFit, cut: CutWire) -> BoolArray:
    """Whether the wire stays in the shapes (B,) of a fit.

    It must be far from snapping, elastic, not taut, and not displaced by errors of its ends by more than
    allowed. The planner requires this on the whole path.
    """
    return _is_stable(_shapes(fit.middle, cut), fit.foot, cut)


def _shapes(middle: FloatArray, cut: CutWire) -> HeavyShape:
    count = len(middle)
    return from_middle(
        middle, np.full(count, cut.length), np.tile([0.0, -cut.wire.load_over_stiffness], (count, 1))
    )


def _is_stable(shape: HeavyShape, foot: FloatArray, cut: CutWire) -> BoolArray:
    margin = np.minimum(shape.margin_in_plane, shape.margin_out_of_plane(cut.wire.stiffness_ratios))
    bent = np.abs(shape.curvature).max(axis=1)
    chord_ratio = np.linalg.norm(shape.points[:, -1] - shape.points[:, 0], axis=1) / shape.length
    displacement = end_sensitivity(shape, foot[:, [0, -1]]).ends * cut.end_error
    good = (margin >= MIN_STABILITY) & (bent <= cut.wire.max_curvature) & (chord_ratio <= MAX_CHORD_RATIO)
    return np.asarray(good & (displacement <= cut.max_displacement))


def _is_held_in_block(fit: FamilyFit, positions: FloatArray, cut: CutWire, half_block: float) -> bool:
    """Whether the wire is held (`is_held`) in shapes of a fit at ``positions`` (K,), clear of the block."""
    sampled = slice(None, None, _HELD_STRIDE)
    shape = _shapes(fit.family.state(positions[sampled]), cut)
    ends = min(float(shape.points[:, -1, 0].min()), float(-shape.points[:, 0, 0].max()))
    return ends >= half_block + END_CLEARANCE_M and bool(_is_stable(shape, fit.foot[sampled], cut).all())
