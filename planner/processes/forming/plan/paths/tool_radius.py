"""Where a ball is too large for a face: at concave creases, where every ball is, and in smooth regions."""

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, dots, lengths
from planner.issues import TandemError, issue_error
from planner.processes.forming.plan.contact import CONTACT_TOLERANCE_M, CREASE_ANGLE_RAD, Contact, ContactFace
from planner.processes.forming.plan.paths.level_lines import LevelLoop

MAX_PUSH_M: Final = 2e-5
"""A ball that a crease pushes aside by more than this [m] does not reach its point."""
FLOOR_CLEARANCE_M: Final = 1e-5
"""Distance [m] of the ball from the floor on the lowest loop at the foot of a wall, in addition to the
distance by which straight moves between targets take it off the wall.

Without it the ball would change from the wall to the floor, facet by facet, and the gap between two tools
would jump from the wall's to the floor's.
"""
MAX_FACET_PUSH_M: Final = 4e-6
"""Distance [m] by which facets of a smooth face push a wider ball aside at most."""
MAX_FLOOR_CLEARANCE_M: Final = 1e-4
"""Maximum clearance [m] from the floor, however coarse the moves."""
MAX_LIFT_M: Final = 8e-5
"""Maximum lift [m] of the lowest loop. Floors that are not level stop the ball in places."""
FREE_HEIGHT_M: Final = 4e-4
"""Height [m] above the lowest loop at which no floor stops the ball."""
_DENSE_SAMPLES: Final = 128
"""Number of points of a loop at which corners of the wall are searched."""
_LOOP_SAMPLES: Final = 32
"""Number of points of a loop at which a ball is tried."""
_NARROW_SAMPLES: Final = 12
"""Approximate number of narrow points, from the narrowest to the widest, at which a smaller ball is tried."""
_RADIUS_TRIALS: Final = 8
"""Maximum number of smaller balls for which whole paths are computed."""
_RADIUS_STEP_M: Final = 1e-5
"""Recommended radii are multiples of this [m]."""
_MAX_WALL_ANGLE_RAD: Final = np.radians(85.0)
"""Maximum wall angle [rad] in the calculation of a ball's reach."""


class Creases:
    """Concave creases and vertices of a face, near which a ball does not reach the face.

    Concave edges with an angle of at least ``CREASE_ANGLE_RAD`` are creases, which are represented by points
    along them. Concave vertices are such points, too. Each point has a reach: the distance from it within
    which the ball of ``face`` may be kept away from the face. If the ball misses a point within a reach, the
    crease is the reason. Elsewhere the face is too narrow for the ball.
    """

    def __init__(self, face: ContactFace) -> None:
        mesh, normals = face.mesh, face.normals
        self._face = face
        directed = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
        owner = np.tile(np.arange(len(mesh.faces)), 3)
        key = directed.min(axis=1) * len(mesh.vertices) + directed.max(axis=1)
        order = np.argsort(key, kind="stable")
        twins = np.flatnonzero(key[order][1:] == key[order][:-1])
        first, second = order[twins], order[twins + 1]
        f, g = owner[first], owner[second]  # faces on both sides of each inner edge
        edge_angle = np.arccos(np.clip(dots(normals[f], normals[g]), -1.0, 1.0))
        centroid = mesh.vertices[mesh.faces].mean(axis=1)
        is_concave = dots(centroid[g] - centroid[f], normals[f]) > 0.0
        # largest angle between facets of a smooth face at each vertex
        self._facet_angle = np.zeros(len(mesh.vertices))
        is_smooth = edge_angle < CREASE_ANGLE_RAD
        for end in range(2):
            np.maximum.at(self._facet_angle, directed[first[is_smooth], end], edge_angle[is_smooth])
        is_crease = is_concave & ~is_smooth
        points, half_angle = [], []
        step = 0.1 * face.radius  # maximum spacing of the points along a crease
        edge_start, edge_end = (mesh.vertices[directed[first[is_crease], end]] for end in range(2))
        part_count = np.maximum(np.ceil(np.linalg.norm(edge_end - edge_start, axis=1) / step), 1).astype(
            np.int64
        )
        edge = np.repeat(np.arange(len(part_count)), part_count + 1)
        fraction = (
            np.arange(len(edge)) - np.repeat(np.cumsum(part_count + 1) - part_count - 1, part_count + 1)
        ) / part_count[edge]
        points.append(edge_start[edge] + fraction[:, None] * (edge_end - edge_start)[edge])
        half_angle.append(0.5 * edge_angle[is_crease][edge])
        # concave points: vertices at which faces deviate from their mean normal by over half a crease angle
        mean = np.zeros_like(mesh.vertices)
        to_faces = np.zeros_like(mesh.vertices)
        for k in range(3):
            np.add.at(mean, mesh.faces[:, k], normals)
            np.add.at(to_faces, mesh.faces[:, k], centroid - mesh.vertices[mesh.faces[:, k]])
        mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)
        deviation = np.zeros(len(mesh.vertices))
        for k in range(3):
            corner = mesh.faces[:, k]
            cosine = dots(mean[corner], normals)
            np.maximum.at(deviation, corner, np.arccos(np.clip(cosine, -1.0, 1.0)))
        is_tip = (deviation > 0.5 * CREASE_ANGLE_RAD) & (dots(mean, to_faces) > 0.0)
        points.append(mesh.vertices[is_tip])
        half_angle.append(deviation[is_tip])
        self._points = np.concatenate(points)
        tangent = np.tan(np.minimum(np.concatenate(half_angle), _MAX_WALL_ANGLE_RAD))
        # a ball of radius R in a crease with half angle b touches its planes R tan b from the crease
        # 5 % more, plus the spacing of the points, so that the reaches of neighbouring points overlap
        self._reach = 1.05 * face.radius * tangent + step
        self._tree = cKDTree(self._points) if len(self._points) else None

    def is_near(self, points: FloatArray) -> BoolArray:
        """Return whether points (N, 3) [m] are where a crease may keep the ball away."""
        result = np.zeros(len(points), dtype=np.bool_)
        if self._tree is None or not len(points):
            return result
        max_reach = float(self._reach.max())
        for start in range(0, len(points), 2000):
            chunk = cKDTree(points[start : start + 2000])
            pairs = chunk.sparse_distance_matrix(self._tree, max_reach, output_type="ndarray")
            result[start + pairs["i"][pairs["v"] <= self._reach[pairs["j"]]]] = True
        return result

    def misses(self, required: FloatArray, contact: Contact) -> BoolArray:
        """Return whether (N,) a crease keeps the ball away from each required point (N, 3) [m].

        That is so if the ball is pushed aside by more than `MAX_PUSH_M` and the point is near a crease.
        """
        out = contact.pushed > MAX_PUSH_M
        out[out] = self.is_near(required[out])
        return np.asarray(out)

    def is_too_narrow(self, required: FloatArray, contact: Contact, missed: float) -> BoolArray:
        """Return whether (N,) the face is too narrow for the ball at each required point.

        It is too narrow if the ball fits nowhere nearby, or if it stays farther away than
        `allowed_distance`. The result is False near a crease, which always keeps a ball away.

        Args:
            required: Required points (N, 3) [m].
            contact: Ball positions for them. ``clear`` (N,) says whether the ball was found to fit.
            missed: Allowed distance [m] without the effect of facets.
        """
        out = ~contact.clear | (contact.gap > missed)
        out[out] = ~self.is_near(required[out])
        indices = np.flatnonzero(out)
        if len(indices):
            out[indices] = ~contact.clear[indices] | (
                contact.gap[indices] > self.allowed_distance(required[indices], missed)
            )
        return np.asarray(out)

    def allowed_distance(self, points: FloatArray, missed: float) -> FloatArray:
        """Return the distance (N,) [m] that the ball may have from points (N, 3).

        It is ``missed`` plus 1.5 R (1 / cos(a / 2) - 1), the space under the ball where facets at the angle a
        to each other represent a smooth face.
        """
        _, face, _ = self._face.nearest(points)
        facet_angle = self._facet_angle[self._face.mesh.faces[face]].max(axis=1)
        return np.asarray(missed + 1.5 * self._face.radius * (1.0 / np.cos(0.5 * facet_angle) - 1.0))


@dataclasses.dataclass(frozen=True)
class LevelSlices:
    """Level lines of a face.

    Attributes:
        levels: Levels (L,) [m].
        groups: Loops of each level.
        slice_face: Cuts the face at given levels (K,) [m]. It returns the loops of each of them.
    """

    levels: FloatArray
    groups: list[list[LevelLoop]]
    slice_face: Callable[[FloatArray], list[list[LevelLoop]]]


def reachable_loops(
    slices: LevelSlices,
    face: ContactFace,
    creases: Creases,
    chord: float,
    wider: ContactFace | None = None,
    missed: float = np.inf,
) -> list[list[LevelLoop]]:
    """Return the loops of each level that the ball reaches, along which it then forms the wall.

    A loop is left out if a crease keeps the ball away from all of it, as around a flat floor. The first level
    without loops below one with loops gets the lowest loops that the ball reaches between both. The lowest
    loops are raised if the floor would push the ball off the wall.

    With a ``wider`` ball a loop is also left out if that ball is pushed aside noticeably more than the ball
    itself. A fillet that just admits the ball thus counts as a crease: a few micrometres aside the ball
    touches another point of the fillet, where the sheet has another thickness. There are two exceptions:

    - The ball would then not come down to the end of the wall, as in a hollow that is round all over. Then no
      fillet counts as a crease.
    - The ball itself stays away by more than ``missed``. Such a loop is kept, so that it is reported.

    Args:
        slices: Level lines of the face.
        face: Face.
        creases: Its creases.
        chord: Maximum deviation [m] of straight moves from the loops.
        wider: The same face with a wider ball, or None.
        missed: Distance [m] from which a ball that stays away is reported.

    Returns:
        Reached loops of each level, from the top level down; empty lists where none are left.
    """

    def fits(loop: LevelLoop, max_push: float = MAX_PUSH_M) -> bool:
        """Return whether a loop is kept: the ball reaches it, and a fillet there is not nearly too narrow."""
        if wider is None or creases.is_near(_sample_loop(loop)[0]).all():
            return _is_reached(loop, face, creases, max_push)
        push = _min_push(loop, face)
        return push > missed or _min_push(loop, wider) - push <= MAX_FACET_PUSH_M

    levels, groups, slice_face = slices.levels, slices.groups, slices.slice_face
    reached = [[loop for loop in group if fits(loop)] for group in groups]
    for k, (group, original) in enumerate(zip(reached, groups, strict=True)):
        if group or not original or k == 0 or not reached[k - 1]:
            continue
        good, bad = float(levels[k - 1]), float(levels[k])
        best_loops: list[LevelLoop] = []
        # the ball must still be at the wall, not lifted off it by the floor
        max_push = min(
            max(CONTACT_TOLERANCE_M, 1.5 * min(_min_push(loop, face) for loop in reached[k - 1])), MAX_PUSH_M
        )
        while good - bad > CONTACT_TOLERANCE_M:
            middle = 0.5 * (good + bad)
            fitting = [loop for loop in slice_face(np.array([middle]))[0] if fits(loop, max_push)]
            good, bad = (middle, bad) if fitting else (good, middle)
            best_loops = fitting or best_loops
        reached[k] = best_loops
    # a fillet must not keep the ball farther away than the foot of a wall does: then no fillet counts
    if wider is not None and not _reaches_end(reached, face.radius, float(levels[-1])):
        return reachable_loops(slices, face, creases, chord)
    out: list[list[LevelLoop]] = []
    previous_level = np.inf
    for k, group in enumerate(reached):
        lifted = group  # only the lowest loops are at the floor
        if not any(reached[k + 1 :]):
            lifted = _lift_off_floor(
                group, slice_face, face, creases, min(chord + FLOOR_CLEARANCE_M, MAX_FLOOR_CLEARANCE_M)
            )
        level = float(lifted[0].point[0, 2]) if lifted else -np.inf
        out.append(lifted if lifted is group or level < previous_level - MAX_PUSH_M else [])
        previous_level = level if out[-1] else previous_level
    return out


def _reaches_end(groups: list[list[LevelLoop]], radius: float, end: float) -> bool:
    """Return whether a ball of ``radius`` [m] on the lowest loops comes down to about the height ``end``."""
    group = next((group for group in reversed(groups) if group), [])
    lowest = [float((loop.point[:, 2] + radius * loop.normal[:, 2]).min()) for loop in group]
    return bool(lowest) and min(lowest) - radius <= end + MAX_FLOOR_CLEARANCE_M


def _lift_off_floor(
    group: list[LevelLoop],
    slice_face: Callable[[FloatArray], list[list[LevelLoop]]],
    face: ContactFace,
    creases: Creases,
    clearance: float,
) -> list[LevelLoop]:
    """Return loops of one level, raised if the floor at the foot of their wall pushes the ball off the wall.

    They are then ``clearance`` [m] higher than the lowest loops at which the ball is free of the floor.
    """
    near_creases = [loop for loop in group if creases.is_near(_sample_loop(loop)[0]).any()]
    if not near_creases:
        return group
    level = float(group[0].point[0, 2])
    corners = _corner_points(slice_face(np.array([level + FREE_HEIGHT_M]))[0], face)
    if max(_max_other_push(loop, face, corners) for loop in near_creases) == 0.0:
        return group

    def is_free(height: float) -> bool:
        """Return whether nothing but its own wall pushes the ball aside on the loops at a height [m]."""
        candidates = slice_face(np.array([height]))[0]
        return bool(candidates) and max(_max_other_push(loop, face, corners) for loop in candidates) == 0.0

    low, high = level, level + MAX_LIFT_M
    if not is_free(high):
        return group
    while high - low > CONTACT_TOLERANCE_M:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if is_free(middle) else (middle, high)
    return slice_face(np.array([high + clearance]))[0]


def _corner_points(loops: list[LevelLoop], face: ContactFace) -> FloatArray:
    """Return points (K, 2) [m] in plan where another wall pushes a ball aside.

    The ``loops`` are so high that no floor does.
    """
    samples = [_sample_loop(loop, _DENSE_SAMPLES) for loop in loops]
    pushed_points = [
        points[face.pushed(points, normal, beyond=CREASE_ANGLE_RAD) > 0.0, :2] for points, normal in samples
    ]
    return np.concatenate([*pushed_points, np.zeros((0, 2))])


def _max_other_push(loop: LevelLoop, face: ContactFace, corners: FloatArray) -> float:
    """Return the maximum distance [m] by which a ball is pushed aside along a loop.

    Pushes by its own wall, and by walls that meet it at ``corners`` (K, 2) [m], do not count.
    """
    points, normal = _sample_loop(loop, _DENSE_SAMPLES)
    if len(corners):
        step = float(np.linalg.norm(np.diff(loop.point, axis=0), axis=1).sum()) / _DENSE_SAMPLES
        is_away = lengths(points[:, None, :2] - corners).min(axis=1) > 1.5 * step
        points, normal = points[is_away], normal[is_away]
    return float(face.pushed(points, normal, beyond=CREASE_ANGLE_RAD).max(initial=0.0))


def _is_reached(loop: LevelLoop, face: ContactFace, creases: Creases, max_push: float = MAX_PUSH_M) -> bool:
    """Return whether the ball reaches a loop: at some point it is pushed aside by at most ``max_push`` [m].

    A loop that is not near creases all along counts as reached.
    """
    return not creases.is_near(_sample_loop(loop)[0]).all() or _min_push(loop, face) <= max_push


def _min_push(loop: LevelLoop, face: ContactFace) -> float:
    """Return the distance [m] by which a ball is pushed aside at a loop's best point."""
    return float(face.pushed(*_sample_loop(loop)).min())


def _sample_loop(loop: LevelLoop, count: int = _LOOP_SAMPLES) -> tuple[FloatArray, FloatArray]:
    """Return evenly spaced points (``count``, 3) [m] of a loop, and unit normals there.

    The loop's own points do not suffice: on large facets it has points at creases only.
    """
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(loop.point, axis=0), axis=1))])
    positions = (np.arange(count) + 0.5) / count * arc[-1]
    segment = np.clip(np.searchsorted(arc, positions, side="right") - 1, 0, len(arc) - 2)
    fraction = ((positions - arc[segment]) / np.maximum(arc[segment + 1] - arc[segment], 1e-12))[:, None]
    normal = (1.0 - fraction) * loop.normal[segment] + fraction * loop.normal[segment + 1]
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    return (1.0 - fraction) * loop.point[segment] + fraction * loop.point[segment + 1], normal


@dataclasses.dataclass(eq=False)
class TooNarrow(Exception):  # noqa: N818
    """Regions of a pass are too narrow for its ball.

    Attributes:
        name: Name of the pass.
        radius: Radius [m] of the ball.
        point: Worst point (3,) [m].
        gap: Distance [m] of the ball from it.
        fits: Radius [m] of a ball that fits at the tested points alone.
    """

    name: str
    radius: float
    point: FloatArray
    gap: float
    fits: float

    def error(self, fits: float | None) -> TandemError:
        """Return the error.

        Args:
            fits: Radius [m] for which a whole path was computed, or None if none was found.
        """
        point_mm = 1e3 * self.point
        message = (
            f"{self.name}: the face is too tight at ({point_mm[0]:.1f}, {point_mm[1]:.1f}, "
            f"{point_mm[2]:.1f}) mm for a ball of radius {1e3 * self.radius:.2f} mm, which stays "
            f"{1e3 * self.gap:.3f} mm away from it; "
        )
        if fits is None:
            message += "no smaller radius was found that fits everywhere: round the part more"
        else:
            message += (
                f"the largest radius that fits is {1e3 * fits:.2f} mm: use a smaller tool or round the "
            )
            message += "part more"
        limit = None if fits is None else 1e3 * fits
        return issue_error("forming.tool_radius", message, value=1e3 * self.radius, limit=limit, unit="mm")


def largest_fitting_radius(
    first: TooNarrow, path: Callable[[float], object], min_radius: float
) -> float | None:
    """Return the first of several decreasing radii [m] for which ``path`` computes the whole path, or None.

    The user is advised to take a ball of this radius. Radii are whole hundredths of a mm. A radius that fits
    at the points of ``first`` may fail on its own path, which has other targets, perhaps at narrower points.
    Then the next one is smaller, by a step that grows. The search ends after ``_RADIUS_TRIALS`` radii, or at
    ``min_radius``.

    Args:
        first: Error of the original ball, with a radius that fits at its narrowest points.
        path: Computes the path for a radius [m].
        min_radius: Lower bound [m] of the radius.
    """
    radius, step = first.fits, 0.0
    for _ in range(_RADIUS_TRIALS):
        radius = np.floor(radius / _RADIUS_STEP_M + 1e-6) * _RADIUS_STEP_M
        if radius <= min_radius:
            return None
        try:
            path(radius)
        except TooNarrow as error:
            step = max(2.0 * step, 0.01 * radius)
            radius = min(error.fits, radius - step)
        else:
            return float(radius)
    return None


def too_narrow_error(
    name: str, face: ContactFace, required: FloatArray, normal: FloatArray, gap: FloatArray, missed: float
) -> TooNarrow:
    """Return the error that points of a face are too narrow for its ball.

    It has the point from which the ball stays farthest away, and the radius of the largest ball that fits at
    about ``_NARROW_SAMPLES`` of the points.

    Args:
        name: Name of the pass.
        face: Face.
        required: Points (N, 3) [m].
        normal: Unit normals (N, 3).
        gap: Distances (N,) [m] of the ball from the points.
        missed: Allowed distance [m].
    """
    order = np.argsort(-gap)
    samples = order[:: -(-len(order) // _NARROW_SAMPLES)]  # step: the quotient rounded up
    low = 0.0
    box = np.stack([required[:, :2].min(axis=0), required[:, :2].max(axis=0)])
    nearby_mesh = ContactFace(face.mesh, face.radius, box).mesh

    def fits(radius: float, is_quick: bool) -> bool:
        """Return whether a ball fits at the samples: by its push if ``is_quick``, else by its distance."""
        smaller = ContactFace(nearby_mesh, radius, box)
        allowed = Creases(smaller).allowed_distance(required[samples], missed)
        if is_quick:
            return bool((smaller.pushed(required[samples], normal[samples]) <= allowed).all())
        every_second = slice(None, None, 2)
        contact = smaller.clear(required[samples][every_second], normal[samples][every_second], rounds=5)
        kept = contact.clear | (contact.pushed < 0.2 * radius)  # clear, or nearly so after these rounds
        return bool((kept & (contact.gap <= allowed[every_second])).all())

    # bisection in two passes: the push is a fast lower bound, the distance after clearing is decisive
    for is_quick in (True, False):
        high = face.radius
        for _ in range(7 if is_quick else 6):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if fits(middle, is_quick) else (low, middle)
    return TooNarrow(name, face.radius, required[order[0]], float(gap[order[0]]), low)
