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
"""Maximum distance between the wire's ends as a fraction of its length; beyond it the wire is taut."""
END_CLEARANCE_M: Final = 0.05
"""Minimum distance [m] of the wire's ends from the block for it to be held safely.

Chosen: jobs require 20 mm on the whole path, between the checked sections the ends come 15 mm nearer, and
holders need space.
"""
_COLUMNS = 161  # positions along x at which values are interpolated; linear between them
_HELD_STRIDE = 3  # the wire is checked to be held in every third section
_MIN_SECTIONS, _MAX_SECTIONS = 8, 100  # steps between the ends of a face, without those close to them
_KNOT_STEP_M = 0.045  # m between knots of the family's spline
_CELL_RANGE = 16, 32  # minimum and maximum number of cells of that spline
_EXTENSION_M = 0.04  # m: extension of wires beyond a face, as jobs require with their default margin


def clip(values: FloatArray, faces: IntArray, axis: int, at: float, keep: int) -> tuple[FloatArray, IntArray]:
    """Clip a mesh at a plane.

    Args:
        values: Values (V, C) of the vertices that are linear over a facet. The first ones are coordinates.
        faces: Facets (F, 3).
        axis: Axis across the plane.
        at: Position of the plane on the axis [m].
        keep: 1 to keep the side of larger coordinates, -1 for the other side.

    Returns:
        Values (V', C) and facets (F', 3) of the part that is kept.
    """
    distance = keep * (values[:, axis] - at)
    is_on_plane = np.abs(distance) < SNAP_TOLERANCE_M
    values = values.copy()
    values[is_on_plane, axis] = at
    distance[is_on_plane] = 0.0
    sign = np.sign(distance).astype(np.int64)[faces]
    has_inside = (sign > 0).any(axis=1)
    has_outside = (sign < 0).any(axis=1)
    cut = faces[has_inside & has_outside]
    signs = sign[has_inside & has_outside]
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
    parts = [faces[has_inside & ~has_outside]]
    # one vertex is kept: a triangle; two are kept: a quadrilateral, as two triangles
    one_kept = signs[:, 0] > 0
    parts.append(np.stack([cut[one_kept, 0], first[one_kept], second[one_kept]], axis=1))
    two_kept = ~one_kept
    parts.append(np.stack([first[two_kept], cut[two_kept, 1], cut[two_kept, 2]], axis=1))
    parts.append(np.stack([first[two_kept], cut[two_kept, 2], second[two_kept]], axis=1))
    kept = np.concatenate(parts)
    used, index = np.unique(kept, return_inverse=True)
    return np.concatenate([values, new_values])[used], np.reshape(index, kept.shape).astype(np.int64)


def cut_out(
    front: TriangleMesh, back: TriangleMesh, bounds: tuple[float, float, float, float]
) -> tuple[TriangleMesh, TriangleMesh]:
    """Cut the panel over x0, x1, y0, y1 [m] out of front and back; their vertices are and stay paired."""
    values, faces = np.concatenate([front.vertices, back.vertices], axis=1), front.faces
    for axis, keep, at in ((0, 1, bounds[0]), (0, -1, bounds[1]), (1, 1, bounds[2]), (1, -1, bounds[3])):
        values, faces = clip(values, faces, axis, at, keep)
    return TriangleMesh(values[:, :3], faces), TriangleMesh(values[:, 3:], faces)


@dataclasses.dataclass(frozen=True)
class BentFace:
    """Projection of a face onto shapes of the wire.

    Attributes:
        shift: Displacement (V,) [m] of each vertex along the element's z.
        deviation: Displacement (V,) [m] of each vertex perpendicular to the surface.
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
        outside: Minimum length [m] outside of the panel, of both ends together.
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
    """Project a face onto shapes of a wire that is along x of the block and swept along y.

    None if the wire is too short, a section turns back over itself, or the fit fails.

    Args:
        face: Face in the block frame.
        up: Direction (3,) of the element's z in the block frame.
        cut: Wire.
        half_block: Half of the block's length along the wire [m].
        end_weight: Weight of the ends of sections in the fit.
    """
    spine = make_spine(face, np.array([0.0, 1.0, 0.0]), normal=False)
    low, high = face.vertices[:, 1].min(), face.vertices[:, 1].max()
    all_sections = cut_sections(
        face, spine, section_positions(low, high, SECTION_STEP_M, _MIN_SECTIONS, _MAX_SECTIONS)
    )
    sections = all_sections.select(np.flatnonzero(all_sections.length > 0.0))
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
    # residuals are distances in the plane of a section, which are longer than those to the surface
    normal_fraction = np.hypot(normal[:, 0], normal[:, 2])
    facing = dots(normal, np.broadcast_to(up, normal.shape))
    # residuals are along the left normal of the section, which points up, as fronts do
    deviation = -residual * normal_fraction
    shift = deviation / np.abs(facing)
    held = _is_held_in_block(fit, sections.p, cut, half_block + abs(spine.across))
    return BentFace(shift, deviation, float(np.abs(fit.residual).max()), held)


def _interpolate(
    positions: FloatArray, across: FloatArray, values: FloatArray, points: FloatArray
) -> FloatArray:
    """Interpolate values (V,) at points (V, 2) linearly between sections and along them.

    Beyond the ends of a section, the values of the nearest section that reaches as far are used, because the
    section's last value does not hold for the wire there. Before the first and after the last section, their
    values are used.

    Args:
        positions: Positions (K,) [m] of the sections along y, ascending.
        across: Positions (K, M) [m] of the values along x, ascending in each section.
        values: Values (K, M).
        points: Points (V, 2) [m].
    """
    x = np.linspace(across.min(), across.max(), _COLUMNS)
    grid = np.stack([np.interp(x, *row_values) for row_values in zip(across, values, strict=True)])
    half_column = 0.5 * (x[1] - x[0])
    inside = (x >= across[:, :1] - half_column) & (x <= across[:, -1:] + half_column)
    indices = np.arange(len(positions))[:, None]
    reaching = np.where(inside, indices, -1)
    previous = np.maximum.accumulate(reaching, axis=0)
    following = np.minimum.accumulate(np.where(inside, indices, len(positions))[::-1], axis=0)[::-1]
    nearest = np.where(previous >= 0, previous, np.minimum(following, len(positions) - 1))
    grid = np.take_along_axis(grid, nearest, axis=0)
    column_position = np.clip((points[:, 0] - x[0]) / (x[-1] - x[0]), 0.0, 1.0) * (_COLUMNS - 1)
    column = np.minimum(column_position.astype(np.int64), _COLUMNS - 2)
    first = np.clip(np.searchsorted(positions, points[:, 1]) - 1, 0, len(positions) - 2)
    section_fraction = np.clip(
        (points[:, 1] - positions[first]) / (positions[first + 1] - positions[first]), 0.0, 1.0
    )
    column_fraction = column_position - column
    lower = grid[first, column] * (1.0 - column_fraction) + grid[first, column + 1] * column_fraction
    upper = grid[first + 1, column] * (1.0 - column_fraction) + grid[first + 1, column + 1] * column_fraction
    return np.asarray(lower + section_fraction * (upper - lower))


def is_held(fit: CurveFit, cut: CutWire) -> BoolArray:
    """Return whether the wire is held safely in each shape (B,) of a fit.

    It must be far from snapping, elastic, not taut, and not displaced by errors of its ends by more than
    allowed. The planner requires this on the whole path.
    """
    return _is_stable(_shapes(fit.middle, cut), fit.foot, cut)


def _shapes(middle: FloatArray, cut: CutWire) -> HeavyShape:
    """Return the shapes of a wire under its weight from its states (B, 6) at mid-length."""
    count = len(middle)
    return from_middle(
        middle, np.full(count, cut.length), np.tile([0.0, -cut.wire.load_over_stiffness], (count, 1))
    )


def _is_stable(shape: HeavyShape, foot: FloatArray, cut: CutWire) -> BoolArray:
    """Return whether each shape (B,) is held; ``foot`` (B, M) [m] are arc lengths of the fitted points."""
    margin = np.minimum(shape.margin_in_plane, shape.margin_out_of_plane(cut.wire.stiffness_ratios))
    curvature = np.abs(shape.curvature).max(axis=1)
    chord_ratio = np.linalg.norm(shape.points[:, -1] - shape.points[:, 0], axis=1) / shape.length
    displacement = end_sensitivity(shape, foot[:, [0, -1]]).ends * cut.end_error
    stable = (
        (margin >= MIN_STABILITY) & (curvature <= cut.wire.max_curvature) & (chord_ratio <= MAX_CHORD_RATIO)
    )
    return np.asarray(stable & (displacement <= cut.max_displacement))


def _is_held_in_block(fit: FamilyFit, positions: FloatArray, cut: CutWire, half_block: float) -> bool:
    """Whether the wire is held (`is_held`) in the sections of a fit, with its ends clear of the block.

    ``positions`` (K,) [m] are those of the sections along y. Every `_HELD_STRIDE`-th one is checked.
    """
    sampled = slice(None, None, _HELD_STRIDE)
    shape = _shapes(fit.family.state(positions[sampled]), cut)
    end_distance = min(float(shape.points[:, -1, 0].min()), float(-shape.points[:, 0, 0].max()))
    return end_distance >= half_block + END_CLEARANCE_M and bool(
        _is_stable(shape, fit.foot[sampled], cut).all()
    )
