"""Alignment of a part file with the part that programs produce, and distances to facets and edges.

If the problem leaves the pose of a part open, a rigid motion, without mirror or scale, must bring the
surfaces of the file onto the surfaces that are cut, with the part in the middle of the block. Only its
existence matters, so how it is found needs no proof: centres and axes of inertia of both give initial poses,
which iterative closest points with tangent planes improve. The deviation of the simulated part is then
computed at points of a surface that the proof has read itself.

Source: Chen and Medioni (1992), Object modelling by registration of multiple range images.
"""

import itertools
from typing import Final

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from planner.geometry.arrays import FloatArray, IntArray
from planner.geometry.mesh import closest_weights
from planner.proof.part_files import Samples, on_triangles
from planner.proof.part_files.produced import ProducedSurface

_EQUAL_MOMENT_FACTOR: Final = 1.3
"""Ratio of the square roots of two moments of inertia up to which the moments count as equal."""
_NORMAL_ROTATIONS: Final = 12
"""Number of rotations about a normal that are tried."""
_NORMAL_WEIGHT: Final = 0.1
"""Weight of the difference of two unit normals against distances, relative to the part's size."""
_OTHER_SURFACE_DISTANCE: Final = 10.0
"""Distance that is added between different surfaces, relative to the part's size, so that the equal back of a
panel is not matched with its front.
"""
_SLIDE_WEIGHT: Final = 0.03
"""Weight of distances along the axes against distances to tangent planes, so that steps do not slide along
the surface.
"""
_SEED_POINTS: Final = 240
"""Number of source points by which initial poses are compared."""
_START_POINTS: Final = 32
"""Number of target points at which a piece of a surface is placed initially."""
_FIRST_STEPS: Final = 6
"""Number of alignment steps of each initial pose before the best pose is chosen."""
_MAX_STEPS: Final = 30
"""Maximum number of alignment steps of the best pose."""
_LEAF_SIZE: Final = 128
"""Points in a leaf of the tree. In seven dimensions this is twice as fast as the usual 16."""
_FLAT_MEAN: Final = 0.8
"""Length of the mean normal above which a surface is nearly flat."""
_FAN_RANGE_RAD: Final = float(np.deg2rad(6.0))
"""Initial range [rad], either way, of rotations of a flat surface in its own plane."""
_FAN_STEPS: Final = 6
"""Number of rotations either way within the range."""
_MIN_FAN_RANGE_RAD: Final = 1e-4
"""Range [rad] at which the refinement of the rotations ends."""
_ORIENTATIONS: Final = 400
"""Number of rotations that cover all orientations, so that the nearest is some 15 degrees away."""


PointCloud = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Points and normals (N, 3) with weights (N,), whose sum is 1, and surface numbers (N,)."""


class _Target:
    """Points of surfaces with normals, and a search for the point with the nearest position and normal.

    It holds the surfaces that the programs produce, onto which those of the part file are aligned. ``size``
    [m] is the size of the part (root mean square distance from its centre), to which weights are relative.
    """

    def __init__(self, parts: list[Samples], size: float) -> None:
        self.points, self.normals, self.weight, number = _merged(parts)
        self.size = size
        self._tree = cKDTree(self._features(self.points, self.normals, number), leafsize=_LEAF_SIZE)

    def _features(self, points: FloatArray, normals: FloatArray, number: FloatArray) -> FloatArray:
        """Return vectors (N, 7) [m] whose distances combine position, normal and surface number."""
        surface_offset = _OTHER_SURFACE_DISTANCE * self.size * number[:, None]
        return np.concatenate([points, _NORMAL_WEIGHT * self.size * normals, surface_offset], axis=1)

    def nearest(
        self, points: FloatArray, normals: FloatArray, number: FloatArray
    ) -> tuple[IntArray, FloatArray]:
        """Return the index (N,) of the nearest point of the same surface, and the distance (N,) [m].

        Points and unit normals are (N, 3), ``number`` (N,) are their surfaces. The distance counts the
        difference of normals, too. It is bounded, so that outliers have less weight.
        """
        distances, indices = self._tree.query(self._features(points, normals, number))
        # 0.3 of the part's size bounds the effect of one outlier.
        return np.asarray(indices), np.minimum(np.asarray(distances), 0.3 * self.size)


def aligned_pose(
    source: list[Samples],
    target: list[Samples],
    bound: FloatArray,
    centre: FloatArray,
    all_around: bool = False,
) -> FloatArray:
    """Return the pose (4, 4) at which ``source`` is nearest to ``target``.

    Only poses at which the bounding box of the part has its centre at ``centre`` are considered.

    Args:
        source: Surfaces of the part, each weighted by its area.
        target: The same surfaces as they are made, in the same order.
        bound: Points (K, 3) [m] that bound the part.
        centre: Centre (3,) [m] of the bounding box of these points in the block.
        all_around: Whether to start from all orientations. This helps if the axes of inertia lead to another
            pose, or if ``source`` has only the guides, whose axes of inertia differ from those of ``target``.
    """
    cloud = _merged(source)
    points, normals, weight, number = cloud
    size = float(np.sqrt(weight @ np.sum((points - weight @ points) ** 2, axis=1)))
    goal = _Target(target, size)
    seed_rows = np.unique(np.linspace(0, len(points) - 1, _SEED_POINTS).astype(np.int64))
    seeds = (
        _all_around(bound, centre)
        if all_around
        else _inertia_poses((points, weight), (goal.points, goal.weight))
    )
    best = _best_pose(seeds, cloud, goal, seed_rows)
    for _ in range(_MAX_STEPS):
        moved_points, moved_normals = _transformed(best, points), normals @ best[:3, :3].T
        nearest, _ = goal.nearest(moved_points, moved_normals, number)
        # The centre is given, so only the rotation about it is optimised.
        moved = (
            _point_to_plane_rotation(
                moved_points, goal.points[nearest], goal.normals[nearest], weight, centre
            )
            @ best
        )
        moved_bound = _transformed(moved, bound)
        moved[:3, 3] += centre - 0.5 * (moved_bound.min(axis=0) + moved_bound.max(axis=0))
        change, best = float(np.abs(moved - best).max()), moved
        if change < 1e-9:
            break
    return _straighten(best, cloud, goal, bound, centre)


def _straighten(
    pose: FloatArray, cloud: PointCloud, goal: _Target, bound: FloatArray, centre: FloatArray
) -> FloatArray:
    """Return the pose of a nearly flat surface, rotated about its mean normal so that the borders coincide.

    Distances to tangent planes leave this rotation free, so distances along the surface count as well. Their
    weight is small, because sample points are apart along the surface even in the right pose. Rotations
    within a range are tried, and the range is narrowed around the best one. Parts that are not nearly flat
    (``_FLAT_MEAN``) keep their pose.
    """
    axis = cloud[2] @ (cloud[1] @ pose[:3, :3].T)
    size = float(np.linalg.norm(axis))
    if size < _FLAT_MEAN:
        return pose
    best, spread = pose, _FAN_RANGE_RAD

    def squared_distance(candidate: FloatArray) -> float:
        """Return the weighted mean square of the distances at a pose."""
        moved_points = _transformed(candidate, cloud[0])
        nearest, _ = goal.nearest(moved_points, cloud[1] @ candidate[:3, :3].T, cloud[3])
        difference = moved_points - goal.points[nearest]
        across = np.einsum("ij,ij->i", difference, goal.normals[nearest])
        return float(cloud[2] @ (across**2 + _SLIDE_WEIGHT**2 * np.sum(difference**2, axis=1)))

    while spread > _MIN_FAN_RANGE_RAD:
        candidates = []
        for angle in np.linspace(-spread, spread, 2 * _FAN_STEPS + 1):
            rotation = np.eye(4)
            rotation[:3, :3] = _rotation(angle * axis / size)
            moved = rotation @ best
            moved_bound = _transformed(moved, bound)
            moved[:3, 3] += centre - 0.5 * (moved_bound.min(axis=0) + moved_bound.max(axis=0))
            # Of equal distances, the smaller rotation is taken.
            candidates.append((squared_distance(moved), abs(float(angle)), moved))
        best = min(candidates, key=lambda candidate: candidate[:2])[2]
        spread /= _FAN_STEPS
    return best


def piece_pose(piece: Samples, whole: Samples) -> FloatArray:
    """Return the pose (4, 4) of ``whole`` at which one region of it is nearest to ``piece``.

    Strips are located by it on a larger surface. Initial poses put the centre of the piece on points all over
    ``whole``, with equal normals, and with several rotations about the normal.
    """
    cloud = _merged([piece])
    points, normals, weight, _ = cloud
    size = float(np.sqrt(weight @ np.sum((points - weight @ points) ** 2, axis=1)))
    goal = _Target([whole], size)
    seed_rows = np.unique(np.linspace(0, len(points) - 1, _SEED_POINTS // 3).astype(np.int64))
    spots = np.unique(np.linspace(0, len(whole.points) - 1, _START_POINTS).astype(np.int64))
    piece_frame, seeds = _frame_with_z(normals.mean(axis=0)), []
    for spot, angle in itertools.product(
        spots.tolist(), 2.0 * np.pi * np.arange(_NORMAL_ROTATIONS) / _NORMAL_ROTATIONS
    ):
        c, s = np.cos(angle), np.sin(angle)
        about_z = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        pose = np.eye(4)
        pose[:3, :3] = _frame_with_z(whole.normals[spot]) @ about_z @ piece_frame.T
        pose[:3, 3] = whole.points[spot] - pose[:3, :3] @ points.mean(axis=0)
        seeds.append(pose)
    best = _best_pose(seeds, cloud, goal, seed_rows, 3)
    for _ in range(_MAX_STEPS):
        best = _icp_step(best, cloud, goal, np.arange(len(points)))
    return np.asarray(np.linalg.inv(best), dtype=np.float64)


def _best_pose(
    seeds: list[FloatArray], cloud: PointCloud, goal: _Target, rows: IntArray, steps: int = _FIRST_STEPS
) -> FloatArray:
    """Return the best of the initial poses ``seeds``, after some alignment steps from each.

    ``rows`` are the indices of the points of the cloud that are used.
    """
    candidates = []
    for seed in seeds:
        pose = seed
        for _ in range(steps):
            pose = _icp_step(pose, cloud, goal, rows)
        _, distances = goal.nearest(
            _transformed(pose, cloud[0][rows]), cloud[1][rows] @ pose[:3, :3].T, cloud[3][rows]
        )
        candidates.append((float(cloud[2][rows] @ distances**2), pose))
    return min(candidates, key=lambda candidate: candidate[0])[1]


def _icp_step(pose: FloatArray, cloud: PointCloud, goal: _Target, rows: IntArray) -> FloatArray:
    """Return a pose (4, 4) after one step of iterative closest points, with the source points ``rows``.

    Each point of the moved cloud is paired with the nearest target point, and the small motion that brings
    the points closest to the tangent planes there is applied.
    """
    moved_points = _transformed(pose, cloud[0][rows])
    nearest, _ = goal.nearest(moved_points, cloud[1][rows] @ pose[:3, :3].T, cloud[3][rows])
    return np.asarray(
        _point_to_plane_motion(moved_points, goal.points[nearest], goal.normals[nearest], cloud[2][rows])
        @ pose
    )


def _transformed(pose: FloatArray, points: FloatArray) -> FloatArray:
    """Return points (N, 3) moved by a pose (4, 4)."""
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def _frame_with_z(normal: FloatArray) -> FloatArray:
    """Return a rotation (3, 3) with z along ``normal``."""
    z = normal / np.linalg.norm(normal)
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x = x / np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _merged(parts: list[Samples]) -> PointCloud:
    """Return the points of all surfaces, each surface weighted by its area and numbered from 0."""
    points = np.concatenate([part.points for part in parts])
    normals = np.concatenate([part.normals for part in parts])
    weight = np.concatenate([np.full(len(part.points), part.area / len(part.points)) for part in parts])
    number = np.repeat(np.arange(len(parts), dtype=np.float64), [len(part.points) for part in parts])
    return points, normals, weight / weight.sum(), number


def _inertia_poses(
    source: tuple[FloatArray, FloatArray], target: tuple[FloatArray, FloatArray]
) -> list[FloatArray]:
    """Return initial poses at which centres and axes of inertia of the source coincide with the target's.

    Both are points (N, 3) and weights (N,). There is a pose for each choice of the signs of the axes. If two
    moments are about equal, their axes are ambiguous. Then there are further poses, rotated about the third
    axis.
    """
    frames = []
    for points, weight in (source, target):
        centre = weight @ points
        centred = points - centre
        moments, axes = np.linalg.eigh((centred * weight[:, None]).T @ centred)
        frames.append((centre, axes, np.sqrt(np.maximum(moments, 1e-30))))
    (source_centre, source_axes, _), (target_centre, target_axes, sizes) = frames
    are_equal = [sizes[k + 1] < _EQUAL_MOMENT_FACTOR * sizes[k] for k in range(2)]
    extra_rotations = [np.eye(3)]
    for k, same in enumerate(are_equal):  # rotations in the plane of the two axes with equal moments
        if same:
            first, second = k, k + 1
            angles = 2.0 * np.pi * np.arange(1, _NORMAL_ROTATIONS) / _NORMAL_ROTATIONS
            for angle in angles:
                extra_rotation = np.eye(3)
                extra_rotation[[first, first, second, second], [first, second, first, second]] = [
                    np.cos(angle),
                    -np.sin(angle),
                    np.sin(angle),
                    np.cos(angle),
                ]
                extra_rotations.append(extra_rotation)
    out = []
    for signs in itertools.product((1.0, -1.0), repeat=3):
        rotation = target_axes @ np.diag(signs) @ source_axes.T
        if np.linalg.det(rotation) < 0.0:
            continue
        for extra_rotation in extra_rotations:
            pose = np.eye(4)
            pose[:3, :3] = target_axes @ extra_rotation @ target_axes.T @ rotation
            pose[:3, 3] = target_centre - pose[:3, :3] @ source_centre
            out.append(pose)
    return out


def _all_around(bound: FloatArray, centre: FloatArray) -> list[FloatArray]:
    """Return initial poses (4, 4) that cover all orientations. They are the same list in every call.

    In each of them, the box around the moved points ``bound`` (K, 3) has its centre at ``centre`` (3,).
    """
    out = []
    for rotation in Rotation.random(_ORIENTATIONS, random_state=0).as_matrix():
        pose = np.eye(4)
        pose[:3, :3] = rotation
        moved_bound = _transformed(pose, bound)
        pose[:3, 3] = centre - 0.5 * (moved_bound.min(axis=0) + moved_bound.max(axis=0))
        out.append(pose)
    return out


def _point_to_plane_motion(
    points: FloatArray, goal: FloatArray, normal: FloatArray, weight: FloatArray
) -> FloatArray:
    """Return the small rigid motion (4, 4) that brings points p (N, 3) closest to planes.

    The planes have points g in ``goal`` and unit normals n, (N, 3) each. Minimised is the weighted sum of
    squares of n_i . (g_i - p_i - w x r_i - t) over the rotation vector w about the centroid and the
    translation t, where r_i is p_i minus the centroid. Distances along all axes are added with a small
    weight.
    """
    centroid = points.mean(axis=0)
    arm = points - centroid
    difference = goal - points
    coefficients = [np.concatenate([np.cross(arm, normal), normal], axis=1)]
    values = [np.einsum("ij,ij->i", difference, normal)]
    scale = [np.sqrt(weight)]
    for axis in np.eye(3):
        flat = np.broadcast_to(axis, arm.shape)
        coefficients.append(np.concatenate([np.cross(arm, flat), flat], axis=1))
        values.append(difference @ axis)
        scale.append(_SLIDE_WEIGHT * np.sqrt(weight))
    factor = np.concatenate(scale)
    solution = np.linalg.lstsq(
        np.concatenate(coefficients) * factor[:, None], np.concatenate(values) * factor, 1e-9
    )[0]
    pose = np.eye(4)
    pose[:3, :3] = _rotation(solution[:3])
    pose[:3, 3] = solution[3:] + centroid - pose[:3, :3] @ centroid
    return pose


def _point_to_plane_rotation(
    points: FloatArray, goal: FloatArray, normal: FloatArray, weight: FloatArray, centre: FloatArray
) -> FloatArray:
    """Return the small rotation (4, 4) about ``centre`` that brings points closest to tangent planes.

    The other arguments are those of :func:`_point_to_plane_motion`.
    """
    coefficients = np.cross(points - centre, normal)
    distances = np.einsum("ij,ij->i", goal - points, normal)
    factor = np.sqrt(weight)
    pose = np.eye(4)
    pose[:3, :3] = _rotation(np.linalg.lstsq(coefficients * factor[:, None], distances * factor, 1e-6)[0])
    pose[:3, 3] = centre - pose[:3, :3] @ centre
    return pose


def _rotation(rotation_vector: FloatArray) -> FloatArray:
    """Return the rotation matrix (3, 3) of a rotation vector [rad] (Rodrigues' formula)."""
    angle = float(np.linalg.norm(rotation_vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = rotation_vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


OUTLINES: Final = frozenset({"outline", "hole"})
"""Names of a plate's contours, without the letters that distinguish several of one kind."""
ON_FACE: Final = 1e-4
"""Distance [m] up to which a claimed face counts as the face that is read from the part file."""


def claimed_points(produced: ProducedSurface, count: int) -> Samples:
    """Return ``count`` evenly spread points of the claimed surface, to locate the part in the block."""
    corners = produced.vertices[produced.faces]
    return on_triangles(corners, np.arange(len(corners)) + 1, count)


def distance_to_facets(points: FloatArray, facets: FloatArray) -> FloatArray:
    """Return the distance (N,) [m] of points (N, 3) to the nearest of many small triangles (F, 3, 3).

    Only the 12 triangles with the nearest centroids are examined for each point.
    """
    candidates = np.asarray(cKDTree(facets.mean(axis=1)).query(points, k=min(12, len(facets)))[1])
    candidates = candidates.reshape(len(points), -1)
    best = np.full(len(points), np.inf)
    for column in candidates.T:
        weights = closest_weights(points, *np.moveaxis(facets[column], 1, 0))
        nearest = np.einsum("nk,nkd->nd", weights, facets[column])
        best = np.minimum(best, np.linalg.norm(points - nearest, axis=1))
    return best


def distance_to_edges(points: FloatArray, rim: FloatArray) -> FloatArray:
    """Return the distance (N,) [m] of points (N, 3) to the nearest of the edges ``rim`` (E, 2, 3).

    Points and edges are projected along z. The distance is infinite without edges.
    """
    start, edges = rim[:, 0, :2], rim[:, 1, :2] - rim[:, 0, :2]
    offsets = points[:, None, :2] - start
    projection = (offsets * edges).sum(axis=2) / np.maximum((edges * edges).sum(axis=1), 1e-30)
    offsets = offsets - np.clip(projection, 0.0, 1.0)[..., None] * edges
    return np.asarray(np.linalg.norm(offsets, axis=2).min(axis=1, initial=np.inf))
