"""Parameter lines of a free-form surface, smoothed along their length, and ruled strips between them.

Lines are smoothed by cubic least-squares splines with even knots, so that facets of a mesh and noise do not
become edges. Strips side by side have mitres: both end on the plane halfway between their normals.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.interpolate import BSpline, make_lsq_spline

from planner.geometry.arrays import FloatArray, dots, lengths, unit
from planner.geometry.curves import arc_length
from planner.geometry.mesh_queries import MeshDistance
from planner.geometry.ruled_approximation import Across, Patch, parameter_grid
from planner.geometry.ruled_wall import CHORD_ERROR_M, RuledWall
from planner.issues import issue_error

LINE_STEP_M: Final = 0.005
"""Distance of the lines between which strips may be [m]."""
LINE_INTERVALS: Final = (24, 256)
"""Minimum and maximum number of intervals between them."""
SAMPLE_INTERVALS: Final = (60, 400)
"""Minimum and maximum number of intervals along lines at which the surface is evaluated."""
MIN_KNOT_STEP_M: Final = 0.02
"""Minimum distance of the knots of smoothed lines [m]. Shorter features are noise, or an edge."""
SMOOTHING_FRACTION: Final = 0.25
"""Fraction of the tolerance for the smoothing of lines."""
CLOSED_DISTANCE_M: Final = 1e-3
"""Maximum distance of opposite sides of a closed surface [m]."""


@dataclasses.dataclass(frozen=True)
class SurfaceLines:
    """Lines of a surface at which strips may begin and end.

    Strips between lines face the surface's outside.

    Attributes:
        points: Points (A, M, 3) [m], smooth along the lines.
        parameters: Value of the parameter at each line (A,).
        distances_across: Mean distance of each line across the surface (A,) [m].
        distances_along: Mean distance of each point along the lines (M,) [m].
    """

    points: FloatArray
    parameters: FloatArray
    distances_across: FloatArray
    distances_along: FloatArray

    def wall(self, low: int, high: int) -> RuledWall:
        """Return the strip between two lines."""
        ends = self.points[[low, high]].swapaxes(0, 1)
        nodes = arc_length(ends.mean(axis=1))
        return RuledWall(nodes, ends, np.gradient(ends, nodes, axis=0, edge_order=2))


def smooth_lines(
    patch: Patch, across: Across, tolerance: float, step: float, nearness: MeshDistance
) -> SurfaceLines:
    """Return lines of one parameter of a surface as cubic splines with as few knots as possible.

    Args:
        patch: The surface.
        across: Parameter across the lines.
        tolerance: Tolerance [m]. The smoothing uses a part of it if the knots permit.
        step: Maximum distance of points along the lines [m].
        nearness: Distance query of the surface.

    Raises:
        TandemError: The surface is closed or comes to a point (``element.surface``).
    """
    even = np.linspace(0.0, 1.0, SAMPLE_INTERVALS[0] + 1)
    rough = parameter_grid(patch, across, even, even)
    extents = [_mean_distances(rough), _mean_distances(rough.swapaxes(0, 1))]
    for ends in (rough[[0, -1]], rough[:, [0, -1]].swapaxes(0, 1)):
        if lengths(ends[1] - ends[0]).max() < CLOSED_DISTANCE_M:
            text = "the surface is closed: two of its sides coincide; divide it into two halves"
            raise issue_error("element.surface", text, field="surface")
    for axis in (0, 1):
        if lengths(np.diff(rough, axis=axis)).sum(axis=axis).min() < CLOSED_DISTANCE_M:
            text = "the surface comes to a point: one of its sides has no length; trim it before that point"
            raise issue_error("element.surface", text, field="surface")
    count = int(np.clip(np.ceil(extents[0][-1] / LINE_STEP_M), *LINE_INTERVALS))
    distances = np.linspace(0.0, extents[0][-1], count + 1)
    parameters = np.interp(distances, extents[0], even)
    along = np.linspace(0.0, 1.0, int(np.clip(np.ceil(extents[1][-1] / LINE_STEP_M), *SAMPLE_INTERVALS)) + 1)
    samples = parameter_grid(patch, across, parameters, along)
    max_knots = max(1, int(min(extents[1][-1] / MIN_KNOT_STEP_M, len(along) / 3)))
    knots = min(4, max_knots)
    while True:
        spline = _spline(along, samples, knots)
        smoothed = spline(along).swapaxes(0, 1)
        # inner lines may slide in the surface, rims may not
        max_slip = nearness.distance(smoothed[::4, ::4].reshape(-1, 3))[0].max()
        rim_deviation = lengths(smoothed[[0, -1]] - samples[[0, -1]]).max()
        if max(max_slip, rim_deviation) <= SMOOTHING_FRACTION * tolerance or knots == max_knots:
            break
        knots = min(2 * knots, max_knots)
    nodes = _nodes(spline, along, step)
    if (across == "u") == patch.outward:  # tangent x ruling is dS/du x dS/dv across v, its opposite across u
        nodes = nodes[::-1]
    lines = np.ascontiguousarray(spline(nodes).swapaxes(0, 1))
    return SurfaceLines(lines, parameters, distances, _mean_distances(lines.swapaxes(0, 1)))


def _mean_distances(lines: FloatArray) -> FloatArray:
    """Return the mean distance (A,) [m] of lines of points (A, B, 3) from the first line."""
    steps = lengths(np.diff(lines, axis=0)).mean(axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _spline(at: FloatArray, samples: FloatArray, intervals: int) -> BSpline:
    """Return the cubic splines nearest to curves (A, S, 3) through samples ``at`` (S,) of their parameter."""
    inner = np.linspace(0.0, 1.0, intervals + 1)
    knots = np.concatenate([[0.0] * 3, inner, [1.0] * 3])
    return make_lsq_spline(at, samples.swapaxes(0, 1), knots, k=3)


def _nodes(spline: BSpline, along: FloatArray, step: float) -> FloatArray:
    """Return parameters (M,) for chords within `CHORD_ERROR_M` of the curves, up to ``step`` [m] long."""
    fine = np.linspace(0.0, 1.0, 4 * (len(along) - 1) + 1)
    speed = lengths(spline(fine, 1)).max(axis=1)
    bend = lengths(spline(fine, 2)).max(axis=1)  # a chord over dt is off by bend dt^2 / 8 at most
    density = np.maximum(speed / step, np.sqrt(bend / (8.0 * CHORD_ERROR_M)))
    total = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(fine))])
    return np.asarray(np.interp(np.linspace(0.0, total[-1], int(np.ceil(total[-1])) + 1), total, fine))


def mitred(walls: Sequence[RuledWall]) -> tuple[list[RuledWall], FloatArray]:
    """Return strips side by side with their mitres, and the angles (N - 1, M) [rad] between neighbours."""
    normals = [[wall.normals(wall.nodes, np.full(len(wall.nodes), t)) for t in (0.0, 1.0)] for wall in walls]
    pairs = [(first[1], second[0]) for first, second in itertools.pairwise(normals)]
    half_normals = [normals[0][0], *(unit(a + b) for a, b in pairs), normals[-1][1]]
    out = []
    for k, wall in enumerate(walls):
        mitres = [half_normals[k + t] / dots(half_normals[k + t], normals[k][t])[:, None] for t in (0, 1)]
        out.append(dataclasses.replace(wall, mitres=np.stack(mitres, axis=1)))
    kinks = [2.0 * np.arctan2(lengths(b - a), lengths(b + a)) for a, b in pairs]
    return out, np.array(kinks).reshape(len(pairs), len(walls[0].nodes))
