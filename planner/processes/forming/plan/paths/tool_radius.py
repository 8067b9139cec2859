"""Where a ball is too large for a face: creases, where every ball is, and smooth places."""

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, dots, lengths
from planner.issues import TandemError, refusal
from planner.processes.forming.plan.contact import CONTACT_TOLERANCE, CREASE_ANGLE, Contact, Face
from planner.processes.forming.plan.paths.level_lines import Loop

PUSHED_DISTANCE: Final = 2e-5
"""A ball that a crease pushes aside by more than this [m] does not reach its place."""
FLOOR_CLEARANCE: Final = 1e-5
"""The lowest loop at the foot of a wall keeps the ball so much farther [m] off the floor than straight moves
between targets take it off the wall, which it would lose for the floor, facet by facet, else: the gap between
two tools would hop from the wall's to the floor's."""
FACET_PUSH: Final = 4e-6
"""What a wider ball may be pushed aside [m] besides: facets make no more of a smooth face."""
MOST_FLOOR_CLEARANCE: Final = 1e-4
"""But no farther than this [m], however coarse the moves."""
MOST_LIFT: Final = 8e-5
"""It is lifted by so much [m] at most: floors that are not level stop the ball here and there."""
FLOOR_HEIGHT: Final = 4e-4
"""So far [m] above the lowest loop no floor stops the ball."""
_DENSE_PLACES: Final = 128
"""Places of a loop where corners of the wall are looked for."""
_LOOP_PLACES: Final = 32
"""Places of a loop where a ball is tried."""
_NARROWEST_PLACES: Final = 12
"""Narrow places about, from the narrowest to the widest, that a smaller ball is tried at."""
_RADIUS_TRIALS: Final = 8
"""Smaller balls that whole paths are laid with at most."""
_RADIUS_STEP: Final = 1e-5
"""Radii that are advised are multiples of this [m]."""
_STEEPEST_WALL: Final = np.radians(85.0)
"""Walls count as no steeper than this [rad], where the reach of a ball about them is worked out."""


class Creases:
    """Concave creases and points of a face, and how far around them the face's ball cannot reach."""

    def __init__(self, face: Face) -> None:
        mesh, normals = face.mesh, face.normals
        self._face = face
        directed = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
        owner = np.tile(np.arange(len(mesh.faces)), 3)
        key = directed.min(axis=1) * len(mesh.vertices) + directed.max(axis=1)
        order = np.argsort(key, kind="stable")
        twin = np.flatnonzero(key[order][1:] == key[order][:-1])
        first, second = order[twin], order[twin + 1]
        f, g = owner[first], owner[second]
        turn = np.arccos(np.clip(dots(normals[f], normals[g]), -1.0, 1.0))
        middle = mesh.vertices[mesh.faces].mean(axis=1)
        concave = dots(middle[g] - middle[f], normals[f]) > 0.0
        # what the facets of a smooth face turn by, at each vertex
        self._turn = np.zeros(len(mesh.vertices))
        flat = turn < CREASE_ANGLE
        for end in range(2):
            np.maximum.at(self._turn, directed[first[flat], end], turn[flat])
        sharp = concave & ~flat
        spots, reach = [], []
        step = 0.1 * face.radius
        one, two = (mesh.vertices[directed[first[sharp], end]] for end in range(2))
        parts = np.maximum(np.ceil(np.linalg.norm(two - one, axis=1) / step), 1).astype(np.int64)
        edge = np.repeat(np.arange(len(parts)), parts + 1)
        share = (np.arange(len(edge)) - np.repeat(np.cumsum(parts + 1) - parts - 1, parts + 1)) / parts[edge]
        spots.append(one[edge] + share[:, None] * (two - one)[edge])
        reach.append(0.5 * turn[sharp][edge])
        # points: vertices around which the faces lean from their mean by more than a crease's half
        mean = np.zeros_like(mesh.vertices)
        pull = np.zeros_like(mesh.vertices)
        for k in range(3):
            np.add.at(mean, mesh.faces[:, k], normals)
            np.add.at(pull, mesh.faces[:, k], middle - mesh.vertices[mesh.faces[:, k]])
        mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)
        lean = np.zeros(len(mesh.vertices))
        for k in range(3):
            corner = mesh.faces[:, k]
            cosine = dots(mean[corner], normals)
            np.maximum.at(lean, corner, np.arccos(np.clip(cosine, -1.0, 1.0)))
        tip = (lean > 0.5 * CREASE_ANGLE) & (dots(mean, pull) > 0.0)
        spots.append(mesh.vertices[tip])
        reach.append(lean[tip])
        self._spots = np.concatenate(spots)
        wide = np.tan(np.minimum(np.concatenate(reach), _STEEPEST_WALL))
        self._reach = 1.05 * face.radius * wide + step
        self._tree = cKDTree(self._spots) if len(self._spots) else None

    def near(self, wanted: FloatArray) -> BoolArray:
        """Whether places (N, 3) [m] lie where a crease may keep the ball off."""
        found = np.zeros(len(wanted), dtype=np.bool_)
        if self._tree is None or not len(wanted):
            return found
        most = float(self._reach.max())
        for start in range(0, len(wanted), 2000):
            some = cKDTree(wanted[start : start + 2000])
            pairs = some.sparse_distance_matrix(self._tree, most, output_type="ndarray")
            found[start + pairs["i"][pairs["v"] <= self._reach[pairs["j"]]]] = True
        return found

    def misses(self, wanted: FloatArray, contact: Contact) -> BoolArray:
        """Whether a crease keeps the ball off the wanted places (N, 3)."""
        out = contact.pushed > PUSHED_DISTANCE
        out[out] = self.near(wanted[out])
        return np.asarray(out)

    def too_narrow(self, wanted: FloatArray, contact: Contact, missed: float) -> BoolArray:
        """Whether smooth places (N, 3) are too narrow for the ball: it stays farther off than ``missed`` [m]
        and than what the mesh's facets leave under it, or fits nowhere near."""
        out = ~contact.clear | (contact.gap > missed)
        out[out] = ~self.near(wanted[out])
        rows = np.flatnonzero(out)
        if len(rows):
            out[rows] = ~contact.clear[rows] | (contact.gap[rows] > self.allowed(wanted[rows], missed))
        return np.asarray(out)

    def allowed(self, wanted: FloatArray, missed: float) -> FloatArray:
        """How far (N,) [m] the ball may stay off places (N, 3): ``missed`` and what is under it where facets
        stand for a smooth face."""
        _, face, _ = self._face.nearest(wanted)
        turn = self._turn[self._face.mesh.faces[face]].max(axis=1)
        return np.asarray(missed + 1.5 * self._face.radius * (1.0 / np.cos(0.5 * turn) - 1.0))


def lowest_reached(
    groups: list[list[Loop]],
    levels: FloatArray,
    sliced: Callable[[FloatArray], list[list[Loop]]],
    face: Face,
    creases: Creases,
    chord: float,
    wider: Face | None = None,
    missed: float = np.inf,
) -> list[list[Loop]]:
    """The loops of each of the ``levels`` (L,) without those that a crease, as around a flat floor, keeps the
    ball off all along; in place of the first level without any the lowest one that the ball reaches. Straight
    moves are off the loops by up to ``chord`` [m].

    So are those all along which a ``wider`` ball is pushed aside farther: a fillet that the ball just fits
    counts as a crease, for a few micrometres aside it touches another place of it, where the sheet is of
    another thickness. Where the ball would stay off more than the foot of a wall for it, as in a hollow that
    is round all over, none counts; nor does a fillet that is so narrow that the ball itself stays off by more
    than ``missed`` [m], which is to be told.
    """

    def fits(loop: Loop, most: float = PUSHED_DISTANCE) -> bool:
        if wider is None or creases.near(_sample(loop)[0]).all():
            return _reached(loop, face, creases, most)
        off = _pushed(loop, face)
        return off > missed or _pushed(loop, wider) - off <= FACET_PUSH

    reached = [[loop for loop in group if fits(loop)] for group in groups]
    for k, (group, before) in enumerate(zip(reached, groups, strict=True)):
        if group or not before or k == 0 or not reached[k - 1]:
            continue
        good, bad = float(levels[k - 1]), float(levels[k])
        best: list[Loop] = []
        # so that the ball is still at the wall, not lifted off it by the floor
        most = min(
            max(CONTACT_TOLERANCE, 1.5 * min(_pushed(loop, face) for loop in reached[k - 1])), PUSHED_DISTANCE
        )
        while good - bad > CONTACT_TOLERANCE:
            middle = 0.5 * (good + bad)
            found = [loop for loop in sliced(np.array([middle]))[0] if fits(loop, most)]
            good, bad = (middle, bad) if found else (good, middle)
            best = found or best
        reached[k] = best
    if wider is not None and not _ends_low(reached, face.radius, float(levels[-1])):
        return lowest_reached(groups, levels, sliced, face, creases, chord)
    out: list[list[Loop]] = []
    last = np.inf
    for k, group in enumerate(reached):
        lifted = group  # the floor is at the foot of the lowest loops alone
        if not any(reached[k + 1 :]):
            lifted = _lifted(group, sliced, face, creases, min(chord + FLOOR_CLEARANCE, MOST_FLOOR_CLEARANCE))
        level = float(lifted[0].point[0, 2]) if lifted else -np.inf
        out.append(lifted if lifted is group or level < last - PUSHED_DISTANCE else [])
        last = level if out[-1] else last
    return out


def _ends_low(groups: list[list[Loop]], radius: float, end: float) -> bool:
    """Whether a ball on the lowest loops comes down to the level ``end`` [m] about."""
    group = next((group for group in reversed(groups) if group), [])
    lowest = [float((loop.point[:, 2] + radius * loop.normal[:, 2]).min()) for loop in group]
    return bool(lowest) and min(lowest) - radius <= end + MOST_FLOOR_CLEARANCE


def _lifted(
    group: list[Loop],
    sliced: Callable[[FloatArray], list[list[Loop]]],
    face: Face,
    creases: Creases,
    clear: float,
) -> list[Loop]:
    """Loops of one level, ``clear`` [m] higher where the floor at the foot of their wall pushes the ball off
    it."""
    near = [loop for loop in group if creases.near(_sample(loop)[0]).any()]
    if not near:
        return group
    level = float(group[0].point[0, 2])
    beside = _corners(sliced(np.array([level + FLOOR_HEIGHT]))[0], face)
    if max(_stopped(loop, face, beside) for loop in near) == 0.0:
        return group

    def free(height: float) -> bool:
        found = sliced(np.array([height]))[0]
        return bool(found) and max(_stopped(loop, face, beside) for loop in found) == 0.0

    low, high = level, level + MOST_LIFT
    if not free(high):
        return group
    while high - low > CONTACT_TOLERANCE:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if free(middle) else (middle, high)
    return sliced(np.array([high + clear]))[0]


def _corners(loops: list[Loop], face: Face) -> FloatArray:
    """Places (K, 2) [m] in plan where another wall pushes a ball aside on loops above any floor."""
    at = [_sample(loop, _DENSE_PLACES) for loop in loops]
    found = [place[face.pushed(place, normal, beyond=CREASE_ANGLE) > 0.0, :2] for place, normal in at]
    return np.concatenate([*found, np.zeros((0, 2))])


def _stopped(loop: Loop, face: Face, beside: FloatArray) -> float:
    """By how much [m] at most something else than the wall it is on, and those that meet it ``beside`` (K, 2)
    [m], pushes a ball aside along a loop."""
    place, normal = _sample(loop, _DENSE_PLACES)
    if len(beside):
        step = float(np.linalg.norm(np.diff(loop.point, axis=0), axis=1).sum()) / _DENSE_PLACES
        away = lengths(place[:, None, :2] - beside).min(axis=1) > 1.5 * step
        place, normal = place[away], normal[away]
    return float(face.pushed(place, normal, beyond=CREASE_ANGLE).max(initial=0.0))


def _reached(loop: Loop, face: Face, creases: Creases, most: float = PUSHED_DISTANCE) -> bool:
    return not creases.near(_sample(loop)[0]).all() or _pushed(loop, face) <= most


def _pushed(loop: Loop, face: Face) -> float:
    """By how much [m] a ball is pushed aside at a loop's best place."""
    return float(face.pushed(*_sample(loop)).min())


def _sample(loop: Loop, count: int = _LOOP_PLACES) -> tuple[FloatArray, FloatArray]:
    """Places (``count``, 3) of a loop, evenly along it, and unit normals there: on large facets its rows are
    at creases only."""
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(loop.point, axis=0), axis=1))])
    wanted = (np.arange(count) + 0.5) / count * at[-1]
    row = np.clip(np.searchsorted(at, wanted, side="right") - 1, 0, len(at) - 2)
    share = ((wanted - at[row]) / np.maximum(at[row + 1] - at[row], 1e-12))[:, None]
    normal = (1.0 - share) * loop.normal[row] + share * loop.normal[row + 1]
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    return (1.0 - share) * loop.point[row] + share * loop.point[row + 1], normal


@dataclasses.dataclass(eq=False)
class TooNarrow(Exception):  # noqa: N818
    """Places of a pass are too narrow for its ball of ``radius`` [m]: at the worst one, ``place`` (3,) [m],
    it stays ``gap`` [m] off. By these places alone one of ``fits`` [m] does."""

    name: str
    radius: float
    place: FloatArray
    gap: float
    fits: float

    def error(self, fits: float | None) -> TandemError:
        """The error, with the radius [m] that a whole path was laid with, or None where none was found."""
        at = 1e3 * self.place
        what = (
            f"{self.name}: the face is bent too tightly at ({at[0]:.1f}, {at[1]:.1f}, {at[2]:.1f}) mm for a "
            f"ball of radius {1e3 * self.radius:.2f} mm, which stays {1e3 * self.gap:.3f} mm off it; "
        )
        if fits is None:
            what += "no smaller radius was found that fits everywhere: round the part more"
        else:
            what += f"the largest radius that fits is {1e3 * fits:.2f} mm: take a smaller tool or round the "
            what += "part more"
        limit = None if fits is None else 1e3 * fits
        return refusal("forming.tool_radius", what, value=1e3 * self.radius, limit=limit, unit="mm")


def largest(first: TooNarrow, path: Callable[[float], object], above: float) -> float | None:
    """The largest radius [m] of those tried with which ``path`` lays the whole path, in whole hundredths of a
    mm, ``above`` a least one [m]; or None. Paths of other balls have other targets, perhaps narrower ones."""
    radius, step = first.fits, 0.0
    for _ in range(_RADIUS_TRIALS):
        radius = np.floor(radius / _RADIUS_STEP + 1e-6) * _RADIUS_STEP
        if radius <= above:
            return None
        try:
            path(radius)
        except TooNarrow as error:
            step = max(2.0 * step, 0.01 * radius)
            radius = min(error.fits, radius - step)
        else:
            return float(radius)
    return None


def refuse(
    name: str, face: Face, wanted: FloatArray, normal: FloatArray, gap: FloatArray, missed: float
) -> TooNarrow:
    """That places (N, 3) [m] of a face are too narrow for its ball: the worst of them, and the largest ball
    that fits a few of them."""
    order = np.argsort(-gap)
    rows = order[:: -(-len(order) // _NARROWEST_PLACES)]
    low = 0.0
    box = np.stack([wanted[:, :2].min(axis=0), wanted[:, :2].max(axis=0)])
    around = Face(face.mesh, face.radius, box).mesh

    def fits(radius: float, quick: bool) -> bool:
        smaller = Face(around, radius, box)
        allowed = Creases(smaller).allowed(wanted[rows], missed)
        if quick:
            return bool((smaller.pushed(wanted[rows], normal[rows]) <= allowed).all())
        few = slice(None, None, 2)
        contact = smaller.clear(wanted[rows][few], normal[rows][few], rounds=5)
        kept = contact.clear | (contact.pushed < 0.2 * radius)  # or soon would be
        return bool((kept & (contact.gap <= allowed[few])).all())

    # a ball that is hardly pushed at all fits: a bound soon found; what counts is how far it stays off
    for quick in (True, False):
        high = face.radius
        for _ in range(7 if quick else 6):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if fits(middle, quick) else (low, middle)
    return TooNarrow(name, face.radius, wanted[order[0]], float(gap[order[0]]), low)
