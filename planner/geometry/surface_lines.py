"""Lines of one parameter of a free-form surface, smoothed along their length, and ruled strips between them.

Smoothing is by cubic splines of least squares with even knots, so facets of a mesh and noise do not become
edges. Strips side by side have mitres: both end on the plane half-way between their normals.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.interpolate import BSpline, make_lsq_spline

from planner.geometry.arrays import FloatArray, dots, lengths, unit
from planner.geometry.curves import arc_length
from planner.geometry.mesh_queries import Nearness
from planner.geometry.ruled_approximation import Across, Patch, parameter_grid
from planner.geometry.ruled_wall import CHORD, RuledWall
from planner.issues import refusal

LINE_STEP: Final = 0.005
"""Distance [m] of the lines between which strips may lie."""
LINES: Final = (24, 256)
"""Least and most intervals between them."""
SAMPLES: Final = (60, 400)
"""Least and most intervals along lines at which the surface is looked at."""
KNOT_STEP: Final = 0.02
"""Least distance [m] of the knots of smoothed lines: what is shorter is noise, or an edge."""
SMOOTHED: Final = 0.25
"""Share of the tolerance that lines take for being smooth, where they can."""
CLOSED: Final = 1e-3
"""A surface whose opposite sides are no farther apart [m] is closed."""


@dataclasses.dataclass(frozen=True)
class Lines:
    """Lines of a surface where strips may begin and end: ``points`` (A, M, 3) [m], smooth along the lines.

    ``share`` (A,): the parameter's value at each, ``places`` (A,) [m]: how far across it is; ``way`` (M,)
    [m]: how far along, each in the mean. Strips between lines look to the surface's outside.
    """

    points: FloatArray
    share: FloatArray
    places: FloatArray
    way: FloatArray

    def wall(self, low: int, high: int) -> RuledWall:
        """The strip between two lines."""
        ends = self.points[[low, high]].swapaxes(0, 1)
        nodes = arc_length(ends.mean(axis=1))
        return RuledWall(nodes, ends, np.gradient(ends, nodes, axis=0, edge_order=2))


def smooth_lines(patch: Patch, across: Across, tolerance: float, step: float, near: Nearness) -> Lines:
    """Lines of one parameter of a surface, cubic splines with the fewest knots that take no more than a part
    of the ``tolerance`` [m], or with knots as near as they may be; their points are no farther apart than
    ``step`` [m]. Raises ``TandemError``: ``element.surface`` for surfaces that are closed or come to a point.
    """
    even = np.linspace(0.0, 1.0, SAMPLES[0] + 1)
    rough = parameter_grid(patch, across, even, even)
    far = [_mean_way(rough), _mean_way(rough.swapaxes(0, 1))]
    for ends in (rough[[0, -1]], rough[:, [0, -1]].swapaxes(0, 1)):
        if lengths(ends[1] - ends[0]).max() < CLOSED:
            what = "the surface is closed: two of its sides are one; give it in two halves"
            raise refusal("element.surface", what, field="surface")
    for axis in (0, 1):
        if lengths(np.diff(rough, axis=axis)).sum(axis=axis).min() < CLOSED:
            what = "the surface comes to a point: one of its sides has no length; cut it off before that"
            raise refusal("element.surface", what, field="surface")
    count = int(np.clip(np.ceil(far[0][-1] / LINE_STEP), *LINES))
    places = np.linspace(0.0, far[0][-1], count + 1)
    share = np.interp(places, far[0], even)
    sight = np.linspace(0.0, 1.0, int(np.clip(np.ceil(far[1][-1] / LINE_STEP), *SAMPLES)) + 1)
    wanted = parameter_grid(patch, across, share, sight)
    most = max(1, int(min(far[1][-1] / KNOT_STEP, len(sight) / 3)))
    knots = min(4, most)
    while True:
        spline = _spline(sight, wanted, knots)
        own = spline(sight).swapaxes(0, 1)
        # inner lines may slide in the surface, rims may not
        slid = near.distance(own[::4, ::4].reshape(-1, 3))[0].max()
        rims = lengths(own[[0, -1]] - wanted[[0, -1]]).max()
        if max(slid, rims) <= SMOOTHED * tolerance or knots == most:
            break
        knots = min(2 * knots, most)
    at = _nodes(spline, sight, step)
    if (across == "u") == patch.right:  # tangent x ruling is dS/du x dS/dv across v, its opposite across u
        at = at[::-1]
    lines = np.ascontiguousarray(spline(at).swapaxes(0, 1))
    return Lines(lines, share, places, _mean_way(lines.swapaxes(0, 1)))


def _mean_way(rows: FloatArray) -> FloatArray:
    """How far (A,) [m] rows of points (A, B, 3) are from the first, in the mean."""
    steps = lengths(np.diff(rows, axis=0)).mean(axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _spline(at: FloatArray, wanted: FloatArray, intervals: int) -> BSpline:
    """The cubic splines nearest to curves (A, S, 3) through samples ``at`` (S,) of their parameter."""
    inner = np.linspace(0.0, 1.0, intervals + 1)
    knots = np.concatenate([[0.0] * 3, inner, [1.0] * 3])
    return make_lsq_spline(at, wanted.swapaxes(0, 1), knots, k=3)


def _nodes(spline: BSpline, sight: FloatArray, step: float) -> FloatArray:
    """Values (M,) of the parameter such that no curve is off its chords by more than ``CHORD``, nor any of
    them longer than ``step`` [m]."""
    fine = np.linspace(0.0, 1.0, 4 * (len(sight) - 1) + 1)
    speed = lengths(spline(fine, 1)).max(axis=1)
    bend = lengths(spline(fine, 2)).max(axis=1)  # a chord over dt is off by bend dt^2 / 8 at most
    density = np.maximum(speed / step, np.sqrt(bend / (8.0 * CHORD)))
    spent = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(fine))])
    return np.asarray(np.interp(np.linspace(0.0, spent[-1], int(np.ceil(spent[-1])) + 1), spent, fine))


def mitred(walls: Sequence[RuledWall]) -> tuple[list[RuledWall], FloatArray]:
    """Strips side by side, each with its mitres, and the angles (N - 1, M) [rad] between neighbours."""
    normals = [[wall.normals(wall.nodes, np.full(len(wall.nodes), t)) for t in (0.0, 1.0)] for wall in walls]
    pairs = [(one[1], other[0]) for one, other in itertools.pairwise(normals)]
    halves = [normals[0][0], *(unit(a + b) for a, b in pairs), normals[-1][1]]
    out = []
    for k, wall in enumerate(walls):
        own = [halves[k + t] / dots(halves[k + t], normals[k][t])[:, None] for t in (0, 1)]
        out.append(dataclasses.replace(wall, mitres=np.stack(own, axis=1)))
    kinks = [2.0 * np.arctan2(lengths(b - a), lengths(b + a)) for a, b in pairs]
    return out, np.array(kinks).reshape(len(pairs), len(walls[0].nodes))
