"""How a part as read here lies on what programs make, and how far off what they make is.

Where the problem leaves open how a part is turned, a rigid motion, without mirror or scale, brings
what the file says onto what is cut, with the part in the middle of the block. Whether there is one
is what matters, so how it was found needs no proof: the middle and the axes of inertia of both,
then steps to the nearest places (Y. Chen and G. Medioni, 1992). At places of a surface that the
proof has read itself, it is then told how far each place is off the simulated part.
"""

import itertools
from typing import Final

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from planner.geometry.arrays import FloatArray, IntArray
from planner.geometry.mesh import closest_on_triangles
from planner.proof.part_files import Samples, on_triangles
from planner.proof.part_files.made import Made

_SAME_MOMENT_FACTOR: Final = 1.3
"""Moments of inertia whose square roots differ by less than this factor may be the same."""
_NORMAL_TURNS: Final = 12
"""Turns about a normal that are tried."""
_NORMAL_WEIGHT: Final = 0.1
"""Weight, of the part's size, of the angle between normals against distance."""
_OTHER_SURFACE_DISTANCE: Final = 10.0
"""Distance, in the part's size, to another surface: the back of a panel that is alike on both sides is no
place for its front."""
_SLIDE_WEIGHT: Final = 0.03
"""Weight of distances along the surface, which keep steps from sliding."""
_SEED_PLACES: Final = 240
"""Places of the source at which poses to begin with are judged."""
_START_SPOTS: Final = 32
"""Places of the target at which a piece of a surface is tried."""
_FIRST_STEPS: Final = 6
"""Steps of each pose before the best of them is chosen."""
_MOST_STEPS: Final = 30
"""Steps of the best pose at most."""
_LEAF_SIZE: Final = 128
"""Places in a leaf of the tree, which is twice as fast so, in seven dimensions, as with the usual 16."""
_FLAT_MEAN: Final = 0.8
"""A surface whose mean normal is longer than this is nearly flat."""
_FAN_ANGLE: Final = float(np.deg2rad(6.0))
"""Turns of a flat surface in its own plane, by so much either way [rad],"""
_FAN_STEPS: Final = 6
"""in so many steps either way,"""
_FAN_FINEST: Final = 1e-4
"""and, with ever finer steps, down to so much [rad]."""
_TURNS_ALL_OVER: Final = 400
"""Turns all over, the nearest of which is some 15 degrees off."""


Cloud = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Points and normals (N, 3) with weights and the numbers of their surfaces (N,)."""


class _Target:
    """Places of a surface with normals, and what is nearest to others of both."""

    def __init__(self, parts: list[Samples], size: float) -> None:
        self.points, self.normals, self.weight, number = _together(parts)
        self.size = size
        self._tree = cKDTree(self._told(self.points, self.normals, number), leafsize=_LEAF_SIZE)

    def _told(self, points: FloatArray, normals: FloatArray, number: FloatArray) -> FloatArray:
        apart = _OTHER_SURFACE_DISTANCE * self.size * number[:, None]
        return np.concatenate([points, _NORMAL_WEIGHT * self.size * normals, apart], axis=1)

    def near(
        self, points: FloatArray, normals: FloatArray, number: FloatArray
    ) -> tuple[IntArray, FloatArray]:
        """The nearest places (N,) of the same surface to points with normals (N, 3), and how far they are,
        bounded [m]."""
        apart, at = self._tree.query(self._told(points, normals, number))
        return np.asarray(at), np.minimum(np.asarray(apart), 0.3 * self.size)


def aligned_pose(
    source: list[Samples],
    target: list[Samples],
    bound: FloatArray,
    middle: FloatArray,
    all_around: bool = False,
) -> FloatArray:
    """The pose (4, 4) at which ``source`` is nearest to ``target``, which has the same surfaces in the same
    order, each counting by its area, with the box around ``bound`` (K, 3) about ``middle`` (3,).

    ``all_around``: begin from turns all over, for where the axes of inertia lead to another pose, or are not
    those of what is made, of which ``source`` may have the guides only."""
    cloud = points, normals, weight, number = _together(source)
    size = float(np.sqrt(weight @ np.sum((points - weight @ points) ** 2, axis=1)))
    goal = _Target(target, size)
    some = np.unique(np.linspace(0, len(points) - 1, _SEED_PLACES).astype(np.int64))
    seeds = _all_around(bound, middle) if all_around else _seeds((points, weight), (goal.points, goal.weight))
    best = _best(seeds, cloud, goal, some)
    for _ in range(_MOST_STEPS):
        own, up = _at(best, points), normals @ best[:3, :3].T
        at, _ = goal.near(own, up, number)
        # the place is given, so that only the turn about it is looked for
        after = _turned(own, goal.points[at], goal.normals[at], weight, middle) @ best
        seen = _at(after, bound)
        after[:3, 3] += middle - 0.5 * (seen.min(axis=0) + seen.max(axis=0))
        change, best = float(np.abs(after - best).max()), after
        if change < 1e-9:
            break
    return _straightened(best, cloud, goal, bound, middle)


def _straightened(
    pose: FloatArray, cloud: Cloud, goal: _Target, bound: FloatArray, middle: FloatArray
) -> FloatArray:
    """The pose turned about the mean normal so that least lies beyond the borders: on planes alone, a nearly
    flat surface turns freely in its own. Distances to planes count far more, as before: places are apart from
    one another along the surface wherever it lies."""
    axis = cloud[2] @ (cloud[1] @ pose[:3, :3].T)
    size = float(np.linalg.norm(axis))
    if size < _FLAT_MEAN:
        return pose
    best, spread = pose, _FAN_ANGLE

    def apart(one: FloatArray) -> float:
        own = _at(one, cloud[0])
        at, _ = goal.near(own, cloud[1] @ one[:3, :3].T, cloud[3])
        off = own - goal.points[at]
        across = np.einsum("ij,ij->i", off, goal.normals[at])
        return float(cloud[2] @ (across**2 + _SLIDE_WEIGHT**2 * np.sum(off**2, axis=1)))

    while spread > _FAN_FINEST:
        tried = []
        for angle in np.linspace(-spread, spread, 2 * _FAN_STEPS + 1):
            turn = np.eye(4)
            turn[:3, :3] = _rotation(angle * axis / size)
            after = turn @ best
            seen = _at(after, bound)
            after[:3, 3] += middle - 0.5 * (seen.min(axis=0) + seen.max(axis=0))
            tried.append((apart(after), abs(float(angle)), after))
        best = min(tried, key=lambda one: one[:2])[2]
        spread /= _FAN_STEPS
    return best


def found_piece(piece: Samples, whole: Samples) -> FloatArray:
    """The pose (4, 4) at which a part of ``whole`` is nearest to ``piece``."""
    cloud = points, normals, weight, _ = _together([piece])
    size = float(np.sqrt(weight @ np.sum((points - weight @ points) ** 2, axis=1)))
    goal = _Target([whole], size)
    some = np.unique(np.linspace(0, len(points) - 1, _SEED_PLACES // 3).astype(np.int64))
    spots = np.unique(np.linspace(0, len(whole.points) - 1, _START_SPOTS).astype(np.int64))
    here, out = _upright(normals.mean(axis=0)), []
    for spot, turn in itertools.product(
        spots.tolist(), 2.0 * np.pi * np.arange(_NORMAL_TURNS) / _NORMAL_TURNS
    ):
        c, s = np.cos(turn), np.sin(turn)
        around = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        pose = np.eye(4)
        pose[:3, :3] = _upright(whole.normals[spot]) @ around @ here.T
        pose[:3, 3] = whole.points[spot] - pose[:3, :3] @ points.mean(axis=0)
        out.append(pose)
    best = _best(out, cloud, goal, some, 3)
    for _ in range(_MOST_STEPS):
        best = _step(best, cloud, goal, np.arange(len(points)))
    return np.asarray(np.linalg.inv(best), dtype=np.float64)


def _best(
    seeds: list[FloatArray], cloud: Cloud, goal: _Target, some: IntArray, steps: int = _FIRST_STEPS
) -> FloatArray:
    """The best of some poses after a few steps each."""
    tried = []
    for seed in seeds:
        pose = seed
        for _ in range(steps):
            pose = _step(pose, cloud, goal, some)
        _, apart = goal.near(_at(pose, cloud[0][some]), cloud[1][some] @ pose[:3, :3].T, cloud[3][some])
        tried.append((float(cloud[2][some] @ apart**2), pose))
    return min(tried, key=lambda one: one[0])[1]


def _step(pose: FloatArray, cloud: Cloud, goal: _Target, rows: IntArray) -> FloatArray:
    own = _at(pose, cloud[0][rows])
    at, _ = goal.near(own, cloud[1][rows] @ pose[:3, :3].T, cloud[3][rows])
    return np.asarray(_moved(own, goal.points[at], goal.normals[at], cloud[2][rows]) @ pose)


def _at(pose: FloatArray, points: FloatArray) -> FloatArray:
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def _upright(normal: FloatArray) -> FloatArray:
    """A rotation (3, 3) whose z is along ``normal``."""
    z = normal / np.linalg.norm(normal)
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x = x / np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _together(parts: list[Samples]) -> Cloud:
    points = np.concatenate([part.points for part in parts])
    normals = np.concatenate([part.normals for part in parts])
    weight = np.concatenate([np.full(len(part.points), part.area / len(part.points)) for part in parts])
    number = np.repeat(np.arange(len(parts), dtype=np.float64), [len(part.points) for part in parts])
    return points, normals, weight / weight.sum(), number


def _seeds(source: tuple[FloatArray, FloatArray], target: tuple[FloatArray, FloatArray]) -> list[FloatArray]:
    """Poses that bring middle and axes of inertia together, turned on where axes are not told apart."""
    frames = []
    for points, weight in (source, target):
        middle = weight @ points
        off = points - middle
        moments, axes = np.linalg.eigh((off * weight[:, None]).T @ off)
        frames.append((middle, axes, np.sqrt(np.maximum(moments, 1e-30))))
    (here, own, _), (there, goal, sizes) = frames
    alike = [sizes[k + 1] < _SAME_MOMENT_FACTOR * sizes[k] for k in range(2)]
    extra = [np.eye(3)]
    for k, same in enumerate(alike):  # turns about the axis that is told from both
        if same:
            one, two = k, k + 1
            angles = 2.0 * np.pi * np.arange(1, _NORMAL_TURNS) / _NORMAL_TURNS
            for angle in angles:
                turn = np.eye(3)
                turn[[one, one, two, two], [one, two, one, two]] = [
                    np.cos(angle),
                    -np.sin(angle),
                    np.sin(angle),
                    np.cos(angle),
                ]
                extra.append(turn)
    out = []
    for signs in itertools.product((1.0, -1.0), repeat=3):
        rotation = goal @ np.diag(signs) @ own.T
        if np.linalg.det(rotation) < 0.0:
            continue
        for turn in extra:
            pose = np.eye(4)
            pose[:3, :3] = goal @ turn @ goal.T @ rotation
            pose[:3, 3] = there - pose[:3, :3] @ here
            out.append(pose)
    return out


def _all_around(bound: FloatArray, middle: FloatArray) -> list[FloatArray]:
    """Poses with the box around ``bound`` about ``middle``, turned all over, the same ones each time."""
    out = []
    for turn in Rotation.random(_TURNS_ALL_OVER, random_state=0).as_matrix():
        pose = np.eye(4)
        pose[:3, :3] = turn
        seen = _at(pose, bound)
        pose[:3, 3] = middle - 0.5 * (seen.min(axis=0) + seen.max(axis=0))
        out.append(pose)
    return out


def _moved(own: FloatArray, goal: FloatArray, normal: FloatArray, weight: FloatArray) -> FloatArray:
    """The small motion (4, 4) that brings ``own`` (N, 3) onto planes through ``goal`` across ``normal``."""
    middle = own.mean(axis=0)
    arm = own - middle
    off = goal - own
    rows = [np.concatenate([np.cross(arm, normal), normal], axis=1)]
    values = [np.einsum("ij,ij->i", off, normal)]
    scale = [np.sqrt(weight)]
    for axis in np.eye(3):
        flat = np.broadcast_to(axis, arm.shape)
        rows.append(np.concatenate([np.cross(arm, flat), flat], axis=1))
        values.append(off @ axis)
        scale.append(_SLIDE_WEIGHT * np.sqrt(weight))
    factor = np.concatenate(scale)
    solution = np.linalg.lstsq(np.concatenate(rows) * factor[:, None], np.concatenate(values) * factor, 1e-9)[
        0
    ]
    pose = np.eye(4)
    pose[:3, :3] = _rotation(solution[:3])
    pose[:3, 3] = solution[3:] + middle - pose[:3, :3] @ middle
    return pose


def _turned(
    own: FloatArray, goal: FloatArray, normal: FloatArray, weight: FloatArray, middle: FloatArray
) -> FloatArray:
    """The small turn (4, 4) about ``middle`` that brings ``own`` (N, 3) toward planes through ``goal``."""
    rows = np.cross(own - middle, normal)
    off = np.einsum("ij,ij->i", goal - own, normal)
    factor = np.sqrt(weight)
    pose = np.eye(4)
    pose[:3, :3] = _rotation(np.linalg.lstsq(rows * factor[:, None], off * factor, 1e-6)[0])
    pose[:3, 3] = middle - pose[:3, :3] @ middle
    return pose


def _rotation(turn: FloatArray) -> FloatArray:
    """The rotation (3, 3) by a vector [rad] (Rodrigues)."""
    angle = float(np.linalg.norm(turn))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = turn / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


OUTLINES: Final = frozenset({"outline", "hole"})
"""What outlines of a plate are called, before the letters that tell them apart."""
ON_FACE: Final = 1e-4
"""Distance [m] up to which a claimed face is the face that is read from the part file."""


def of_claim(one: Made, count: int) -> Samples:
    """Places of the claimed surface, by which a part is looked for in the block."""
    corners = one.vertices[one.faces]
    return on_triangles(corners, np.arange(len(corners)) + 1, count)


def off_facets(points: FloatArray, facets: FloatArray) -> FloatArray:
    """How far (N,) [m] points (N, 3) are off the nearest of many small triangles (F, 3, 3)."""
    near = np.asarray(cKDTree(facets.mean(axis=1)).query(points, k=min(12, len(facets)))[1])
    near = near.reshape(len(points), -1)
    best = np.full(len(points), np.inf)
    for column in near.T:
        weights = closest_on_triangles(points, *np.moveaxis(facets[column], 1, 0))
        foot = np.einsum("nk,nkd->nd", weights, facets[column])
        best = np.minimum(best, np.linalg.norm(points - foot, axis=1))
    return best


def beside(points: FloatArray, rim: FloatArray) -> FloatArray:
    """How far (N,) [m] points (N, 3) are from the nearest of the edges ``rim`` (E, 2, 3), seen along z."""
    start, way = rim[:, 0, :2], rim[:, 1, :2] - rim[:, 0, :2]
    off = points[:, None, :2] - start
    share = (off * way).sum(axis=2) / np.maximum((way * way).sum(axis=1), 1e-30)
    off = off - np.clip(share, 0.0, 1.0)[..., None] * way
    return np.asarray(np.linalg.norm(off, axis=2).min(axis=1, initial=np.inf))
