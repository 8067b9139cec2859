"""How far a scan is off the wanted face: along its normal, place by place, with what is missing and stray.

Each point of the scan has a foot, the nearest place of the face, and a signed distance along the normal
there. A place of the face takes the median of the nearest feet around it, which a tenth of stray points
hardly moves; a place without feet is part of a hole. Points far from what is around them are named as
stray.
"""

import dataclasses
import functools
from typing import Final

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, lengths, transform
from planner.geometry.mesh import TriangleMesh, closest_on_triangles, small_pieces
from planner.geometry.mesh_queries import Nearness
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Severity, refusal
from planner.problem import Part
from planner.shopfloor.align.probing import ProbedPoints
from planner.shopfloor.scan.cloud import Cloud, require_size
from planner.shopfloor.scan.registration import MAD, Flat, Pose, register

RIM: Final = 8.0 * MM
"""The sheet so far [m] around the part's outline bends with it, and says nothing of where a scan lies."""
FARTHEST: Final = 15.0 * MM
"""Points farther from the wanted face [m] are not of the part."""
BESIDE: Final = 0.94
"""Points that are this share of their distance and more beside the wanted face are not above or below it:
their way to it leans by 70 degrees from its normal."""
LEAST_UP: Final = float(np.cos(80.0 * DEG))
"""Walls of up to 80 degrees are off along z by what their normal says over this."""
SPACING: Final = 2.0 * MM
"""Places of the face are so far apart [m], more where that would be too many of them."""
MOST_PLACES: Final = 30_000
"""Places of the face at most, about."""
AROUND: Final = 2.0 * MM
"""Feet within this [m] of a place say how far it is off."""
NEAREST: Final = 31
"""Of them so many, the nearest."""
LEAST_FEET: Final = 5
"""Places with fewer feet are not known."""
LEAST_PLANE: Final = 12
ONE_SIDE: Final = 0.5 * MM
"""Of so many feet a plane is taken, where their middle is no farther off [m]; else their median."""
PLANE_ROUNDS: Final = 5
WIDE: Final = 2.0
LEAST_SCALE: Final = 1e-6
"""Rounds of its fit; feet that are so many standard deviations off, and so much [m], count a quarter."""
RIDGE: Final = 1e-3
"""A tilt is held to 0 by this share of what feet at `AROUND` would hold it by."""
SPREAD: Final = 5.0
"""Nor are those whose feet are off their median by more than so many times what is usual,"""
LEAST_SPREAD: Final = 0.05 * MM
"""and by so much [m]."""
MOST_POINTS: Final = 400_000
"""Points that are held against the face at most; of more every so manieth."""
AT_ONCE: Final = 50_000
"""Points that are held against the face at once."""
STRAY: Final = 6.0
"""Points that are off what is around them by more than so many standard deviations are stray."""
LEAST_STRAY: Final = 0.2 * MM
"""They are so far off [m] at least."""
HOLE: Final = 3
"""Places without feet next to each other that are a hole at least."""
LEAST_SHARE: Final = 0.4
"""Share of the wanted face that is known at least."""
MOST_NAMED: Final = 8
"""Holes that are named at most."""
MEDIAN_MOST: Final = 6.0 * MM
"""Parts of which half is farther off [m] are other parts."""
LEAST_DEEP: Final = 0.4
MOST_DEEP: Final = 1.3
"""Parts are so many times as deep as they are wanted."""
LEAST_DEPTH: Final = 0.5 * MM
"""Where a face is less off the flat [m] its depth is not asked."""
DEPTHS: Final = 20
"""Bins of places by their wanted depth: what comes back differs from one to the next,"""
MOST_SPREAD: Final = 0.3
"""and within one the depths of the scan do by no more than this share of its depth, root mean square."""
MIRRORED: Final = 0.3
"""A mirror image that is off by less than this share of what the scan is: a mirrored scan."""


@dataclasses.dataclass(frozen=True, eq=False)
class Hole:
    """A part of the face without points of the scan, about ``place`` (3,) [m], ``across`` [m] wide."""

    place: FloatArray
    across: float


@dataclasses.dataclass(frozen=True, eq=False)
class Deviation:
    """Places ``point`` (M, 3) [m] of the wanted ``face`` with their ``normal`` (M, 3), up, and how far the
    scan is ``off`` (M,) [m] along it, NaN where it is not known; ``noise`` [m] of the scan's points, how many
    were ``used`` and are ``stray``, and its ``holes``, the largest first. ``seen`` (K, 3): the
    points of the part that are not stray, in the sheet's frame, and about how far they ``rise`` (K,) [m]
    above the face along z: what they are off along the normal over the cosine of the wall's angle."""

    face: TriangleMesh = dataclasses.field(repr=False)
    point: FloatArray = dataclasses.field(repr=False)
    normal: FloatArray = dataclasses.field(repr=False)
    off: FloatArray = dataclasses.field(repr=False)
    noise: float
    used: int
    stray: int
    holes: tuple[Hole, ...]
    seen: FloatArray = dataclasses.field(repr=False)
    rise: FloatArray = dataclasses.field(repr=False)

    def along_z(self, points: FloatArray) -> FloatArray:
        """How far (N,) [m] the scan is above the face, along z, at places (N, 3) [m] of it; NaN where that is
        not known."""
        tree, above = self._heights
        return _around(tree, above, points).value

    def nearest(self, points: FloatArray) -> FloatArray:
        """The nearest places (N, 3) [m] of the face to points (N, 3) [m]."""
        return _feet(self.face, points)[0]

    @functools.cached_property
    def _heights(self) -> tuple[KDTree, FloatArray]:
        """Where points lie on the face, seen along z, and how far (K,) [m] they are above it."""
        # where what comes back differs along a wall, a foot has another share of it than what is below
        down = np.array([0.0, 0.0, -1.0])
        below = self.seen + self.rise[:, None] * down
        _, left, _, steep = _feet(self.face, below)  # on curved faces: one step of Newton's
        step = left / np.maximum(steep, LEAST_UP)
        return KDTree(below + step[:, None] * down), self.rise + step


def of_part(
    cloud: Cloud, part: Part | None, size: FloatArray, marks: ProbedPoints | None, top: bool
) -> tuple[Pose, Deviation]:
    """Where the scan of a formed ``part`` lies, and how far it is off; of its ``top`` or bottom face, in the
    frame of a sheet of ``size`` (3,) [m]. ``marks``: in that frame, and as the scan has them.

    Raises ``TandemError``: scan.unit, scan.flat, scan.other_part, and of marks align.*.
    """
    if part is None or part.formed is None:
        what = "the part of this problem is not formed of a sheet: a scan has nothing to be held against"
        raise refusal("scan.other_part", what, hint="name the result folder of a forming job")
    mesh = part.formed.mesh
    level = float(size[2]) if top else 0.0
    face = TriangleMesh(mesh.vertices + np.array([0.0, 0.0, level]), np.asarray(mesh.faces))
    require_size(cloud, float(size[:2].max()))
    x, y = 0.5 * size[:2]
    formed = shapely.convex_hull(shapely.multipoints(face.vertices[:, :2])).buffer(RIM)
    flat = Flat(shapely.difference(shapely.box(-x, -y, x, y), formed), level, float(size[:2].min()))
    pose = register(cloud.points, flat, marks)
    return pose, deviation(cloud.points, pose, face, level)


def deviation(points: FloatArray, pose: Pose, face: TriangleMesh, level: float) -> Deviation:
    """How far the ``points`` (N, 3) [m] of a scan at ``pose`` are off a wanted ``face`` with normals up, in a
    sheet whose flat is at the ``level`` [m].

    Raises ``TandemError``: scan.other_part where the scan shows another part, or this one mirrored.
    """
    there = transform(pose.matrix, points)
    outline = shapely.convex_hull(shapely.multipoints(face.vertices[:, :2]))
    shapely.prepare(outline)
    low, high = face.vertices[:, 2].min() - FARTHEST, face.vertices[:, 2].max() + FARTHEST
    near = np.flatnonzero((there[:, 2] >= low) & (there[:, 2] <= high))
    near = near[shapely.contains_xy(outline, there[near, 0], there[near, 1])]
    near = near[:: max(1, -(-len(near) // MOST_POINTS))]
    foot, distance, across, up = _feet(face, there[near])
    over = across <= BESIDE * np.abs(distance)  # else of the flat beside a face whose outline is hollow
    near, foot, distance, up = near[over], foot[over], distance[over], up[over]
    own = np.abs(distance) <= FARTHEST
    foot, distance, up = foot[own], distance[own], np.maximum(up[own], LEAST_UP)
    place, normal, spacing = _places(face)
    _require_part(face, there[near], foot, distance, _share_of_depth(place, there[near], level), level)
    tree = KDTree(foot)
    found = _around(tree, distance, place)
    off = found.value
    known = np.isfinite(off)
    if known.mean() < LEAST_SHARE:
        share = f"{100.0 * known.mean():.0f} % of the wanted face"
        what = f"the scan shows {share}, allowed {100.0 * LEAST_SHARE:g} % or more"
        raise refusal("scan.other_part", what, hint="scan the whole part, from the side of --face")
    _require_shape(place[known], normal[known], off[known], level)
    nearest = np.flatnonzero(known)[KDTree(place[known]).query(foot)[1]]
    # what comes back may change by as much as the way along the wall: a place's is none of a foot's
    beside = foot - place[nearest]
    rest = np.abs(distance - off[nearest] - dots(found.tilt[nearest], beside))
    noise = MAD * float(np.median(rest))
    stray = rest > np.maximum(max(STRAY * noise, LEAST_STRAY), SPREAD * found.spread[nearest])
    return Deviation(
        face,
        place,
        normal,
        off,
        noise,
        len(near),
        int(stray.sum()) + int((~own).sum()),
        tuple(_holes(place[~known], spacing)),
        there[near][own][~stray],
        (distance / up)[~stray],
    )


def _feet(face: TriangleMesh, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Nearest places (N, 3) [m] of a face to points (N, 3), how far (N,) these are above it, how far (N,)
    beside: across the normal, which they are beyond an edge of the face; and the normal's z (N,)."""
    asked = Nearness(face, SPACING)
    foot = np.empty_like(points)
    above, beside, up = np.empty((3, len(points)))
    for begin in range(0, len(points), AT_ONCE):
        some = slice(begin, begin + AT_ONCE)
        distance, index = asked.distance(points[some])
        corners = face.vertices[face.faces[index]]
        weight = closest_on_triangles(points[some], *(corners[:, k] for k in range(3)))
        foot[some] = np.einsum("nk,nkx->nx", weight, corners)
        along = np.einsum("nx,nx->n", points[some] - foot[some], asked.normals[index])
        beside[some] = np.sqrt(np.maximum(distance**2 - along**2, 0.0))
        above[some] = np.where(along >= 0.0, distance, -distance)
        up[some] = asked.normals[index, 2]
    return foot, above, beside, up


def _places(face: TriangleMesh) -> tuple[FloatArray, FloatArray, float]:
    """Places (M, 3) [m] all over a face, the normals (M, 3) there, and how far they are apart [m]."""
    a, b, c = (face.vertices[face.faces[:, k]] for k in range(3))
    whole = np.cross(b - a, c - a)
    area = float(np.linalg.norm(whole, axis=1).sum()) / 2.0
    spacing = max(SPACING, float(np.sqrt(area / MOST_PLACES)))
    pieces, owner = small_pieces(face.vertices[face.faces], spacing * np.sqrt(2.0), 4 * MOST_PLACES)
    middle = pieces.mean(axis=1)
    # one place a cell: parts of small triangles have many pieces there
    cell = np.floor(middle / spacing).astype(np.int64)
    _, first = np.unique(cell, axis=0, return_index=True)
    first.sort()
    normal = whole / np.maximum(np.linalg.norm(whole, axis=1, keepdims=True), 1e-300)
    return middle[first], normal[owner[first]], spacing


@dataclasses.dataclass(frozen=True, eq=False)
class _Around:
    """What feet around M places make there: ``value`` (M,), NaN where that is not known, its ``tilt`` (M, 3)
    from there on, and the median (M,) of how far feet are off, ``spread``."""

    value: FloatArray
    tilt: FloatArray
    spread: FloatArray


def _around(tree: KDTree, value: FloatArray, places: FloatArray) -> _Around:
    """What the ``value`` (K,) of the nearest feet around places (M, 3) makes there: a plane through them in
    which those that are off count little, or their median, of few or where all are to one side."""
    out, spread = np.full(len(places), np.nan), np.full(len(places), np.inf)
    tilt = np.zeros((len(places), 3))
    count = min(NEAREST, len(value))
    for begin in range(0, len(places) if count else 0, AT_ONCE):
        some = places[begin : begin + AT_ONCE]
        _, found = tree.query(some, k=[*range(1, count + 1)], distance_upper_bound=AROUND)
        there: BoolArray = np.asarray(found < len(value))
        found = np.minimum(found, len(value) - 1)
        near = np.where(there, value[found], np.nan)
        beside = np.where(there[:, :, None], tree.data[found] - some[:, None], 0.0)
        feet = there.sum(axis=1)
        rows = np.flatnonzero(feet >= LEAST_FEET)
        middle = np.nanmedian(near[rows], axis=1)
        out[begin + rows] = middle
        spread[begin + rows] = np.nanmedian(np.abs(near[rows] - middle[:, None]), axis=1)
        rows = np.flatnonzero(feet >= LEAST_PLANE)
        height, tilt[begin + rows], spread[begin + rows] = _plane(beside[rows], near[rows])
        # where all of them are to one side a plane says of a hole what is not known
        even = lengths(beside[rows].sum(axis=1)) <= ONE_SIDE * feet[rows]
        out[begin + rows[even]] = height[even]
    # in a hole there are stray points alone, which agree on nothing
    out[spread > SPREAD * float(np.median(spread)) + LEAST_SPREAD] = np.nan
    return _Around(out, tilt, spread)


def _plane(beside: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The height (M,) at their middle of planes through ``value`` (M, K), NaN where there is none, at places
    ``beside`` (M, K, 3) [m] of it, their tilts (M, 3), and the median (M,) of how far values are off: least
    squares, again and again with the weights of Geman and McClure."""
    there: BoolArray = np.asarray(np.isfinite(value))
    known = np.where(there, value, 0.0)
    column = np.concatenate([np.ones((*value.shape, 1)), beside / AROUND], axis=2)
    off = known - np.nanmedian(value, axis=1)[:, None]
    found = np.zeros((len(value), 4))
    for _ in range(PLANE_ROUNDS):
        weight = there / (1.0 + (off / (WIDE * MAD * _typical(off, there)[:, None])) ** 2) ** 2
        whole = np.einsum("mk,mki,mkj->mij", weight, column, column)
        # feet lie on a face: along its normal they say nothing
        whole += RIDGE * weight.sum(axis=1)[:, None, None] * np.diag([0.0, 1.0, 1.0, 1.0])
        right = np.einsum("mk,mki,mk->mi", weight, column, known)
        found = np.linalg.solve(whole, right[:, :, None])[:, :, 0]
        off = known - np.einsum("mki,mi->mk", column, found)
    return found[:, 0], found[:, 1:] / AROUND, _typical(off, there)


def _typical(off: FloatArray, there: BoolArray) -> FloatArray:
    return np.asarray(np.nanmedian(np.where(there, np.abs(off), np.nan), axis=1) + LEAST_SCALE)


def _holes(bare: FloatArray, spacing: float) -> list[Hole]:
    """What is missing, from the places (K, 3) that no point is near to."""
    if not len(bare):
        return []
    pairs: IntArray = KDTree(bare).query_pairs(2.0 * spacing, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(bare), len(bare)))
    count, label = connected_components(graph, directed=False)
    holes = []
    for k in range(count):
        mine = bare[label == k]
        if len(mine) >= HOLE:
            low, high = mine.min(axis=0), mine.max(axis=0)
            holes.append(Hole(0.5 * (low + high), float((high - low).max()) + spacing))
    return sorted(holes, key=lambda hole: -hole.across)


def _share_of_depth(place: FloatArray, points: FloatArray, level: float) -> float:
    """How deep points (N, 3) [m] are, over what the face's places (M, 3) below or above the same spot are:
    the median, where these are off the ``level`` [m]."""
    some = points[:: max(1, len(points) // 20_000)]
    wanted = place[KDTree(place[:, :2]).query(some[:, :2])[1], 2] - level
    deep = np.abs(wanted) > max(0.2 * float(np.abs(wanted).max(initial=0.0)), LEAST_DEPTH)
    return float(np.median((some[deep, 2] - level) / wanted[deep])) if deep.any() else 1.0


def _require_part(
    face: TriangleMesh, points: FloatArray, foot: FloatArray, distance: FloatArray, deep: float, level: float
) -> None:
    """Raise ``TandemError`` (scan.other_part) where a scan does not look like the wanted part at all."""
    typical = float(np.median(np.abs(distance))) if len(distance) else np.inf
    share = len(foot) / max(len(points), 1)
    good = share >= 0.5 and typical <= MEDIAN_MOST and LEAST_DEEP <= deep <= MOST_DEEP
    if good and typical <= 1.0 * MM:
        return
    turned, axis = _mirrored(face, points, level)
    like = turned < MIRRORED * min(typical, FARTHEST)
    if good and not like:
        return
    what = (
        f"half of the scan is farther than {typical / MM:.1f} mm off the wanted face"
        if np.isfinite(typical)
        else "no point of the scan is near the wanted face"
    )
    what += (
        f", {100.0 * (1.0 - share):.0f} % farther than {FARTHEST / MM:g} mm; it is {deep:.2g} times as deep, "
        f"allowed {LEAST_DEEP:g} to {MOST_DEEP:g}"
        if len(points)
        else ": it shows the flat around it alone"
    )
    hint = "name the result folder of the part that was scanned, say which face it shows (--face), give marks"
    if like:
        what += f"; mirrored along {axis} it would be {turned / MM:.2f} mm off"
        hint = "look for an axis with the wrong sign in scan and marks, or swapped columns"
    raise refusal("scan.other_part", what, hint=hint)


def _require_shape(place: FloatArray, normal: FloatArray, off: FloatArray, level: float) -> None:
    """Raise ``TandemError`` (scan.other_part) where places (M, 3) of one wanted depth have many depths in the
    scan: what comes back depends on depth above all, and the shape of another part does not."""
    wanted = place[:, 2] - level
    deep = wanted + off / np.maximum(normal[:, 2], LEAST_UP)
    square = float(np.mean(deep**2))
    if square < LEAST_DEPTH**2:
        return
    bins = np.array_split(deep[np.argsort(wanted, kind="stable")], DEPTHS)
    spread = float(np.sqrt(sum(((one - one.mean()) ** 2).sum() for one in bins if len(one)) / len(deep)))
    share = spread / float(np.sqrt(square))
    if share <= MOST_SPREAD:
        return
    what = (
        f"places of one wanted depth differ by {spread / MM:.1f} mm in the scan's depth (root mean square), "
        f"{100.0 * share:.0f} % of that, allowed {100.0 * MOST_SPREAD:g} %: its shape is another part's, or "
        "it lies beside its place"
    )
    hint = "name the result folder of the part that was scanned, give marks, or measure them again"
    raise refusal("scan.other_part", what, value=100.0 * share, limit=100.0 * MOST_SPREAD, hint=hint)


def _mirrored(face: TriangleMesh, points: FloatArray, level: float) -> tuple[float, str]:
    """By how much [m] half of the points' mirror images are off a face, of those along x, along y and along z
    about the ``level`` [m] the nearest one; and along which. Marks in a plane fit a mirror image turned over:
    that is one along z."""
    some = points[:: max(1, len(points) // 5_000)]
    if not len(some):
        return np.inf, "x"
    values = []
    for axis in range(3):
        image = some.copy()
        image[:, axis] *= -1.0
        image[:, axis] += 2.0 * level if axis == 2 else 0.0
        values.append(float(np.median(np.abs(_feet(face, image)[1]))))
    return min(zip(values, "xyz", strict=True))


def issues(found: Deviation, file: str) -> list[Issue]:
    """What a user has to know of a scan beside its place: what is stray, what is missing."""
    out = []
    if found.stray:
        share = found.stray / found.used
        what = f"{file}: {found.stray} of {found.used} points ({100.0 * share:.1f} %) are stray and left out"
        out.append(Issue("scan.stray", what, Severity.WARNING if share > 0.2 else Severity.NOTE))
    missing = float((~np.isfinite(found.off)).mean())
    for hole in found.holes[:MOST_NAMED]:
        x, y, z = hole.place / MM
        what = f"{file}: a hole {hole.across / MM:.0f} mm across at ({x:.0f}, {y:.0f}, {z:.0f}) mm"
        out.append(Issue("scan.hole", what, Severity.WARNING, value=hole.across / MM, unit="mm"))
    if len(found.holes) > MOST_NAMED:
        more = len(found.holes) - MOST_NAMED
        what = f"{file}: {more} more holes; in all {100.0 * missing:.1f} % of the face is missing"
        out.append(Issue("scan.hole", what, Severity.WARNING))
    return out
