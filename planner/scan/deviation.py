"""How far a scan is off the wanted face: along its normal, place by place, with what is missing and stray.

Each point of the scan has a foot, the nearest place of the face, and a signed distance along the normal
there. A place of the face takes the median of the nearest feet around it, which a tenth of stray points
hardly moves; a place without feet is part of a hole. Points far from what is around them are named as
stray.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from planner.align.probing import ProbedPoints
from planner.geometry.arrays import FloatArray, IntArray, transform
from planner.geometry.mesh import TriangleMesh, closest_on_triangles, small_pieces
from planner.geometry.mesh_queries import Nearness
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Severity, TandemError
from planner.problem import Part
from planner.scan.cloud import Cloud, require_size
from planner.scan.registration import MAD, Flat, Pose, register

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
SIDEWAYS: Final = 0.2 * MM
"""A scan that may lie farther [m] beside the part than this is told,"""
SIDEWAYS_SHARE: Final = 0.5
"""where this explains more than such a share of what it is off."""
LEAST_DEEP: Final = 0.4
MOST_DEEP: Final = 1.6
"""Parts are so many times as deep as they are wanted."""
LEAST_DEPTH: Final = 0.5 * MM
"""Where a face is less off the flat [m] its depth is not asked."""
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
    were ``used`` and are ``stray``, and its ``holes``, the largest first. ``below`` (K, 3):
    where points that are not stray lie on the face, seen along z, and how far they are ``above`` (K,) it:
    about what they are off along the normal over the cosine of the wall's angle [m]."""

    face: TriangleMesh = dataclasses.field(repr=False)
    point: FloatArray = dataclasses.field(repr=False)
    normal: FloatArray = dataclasses.field(repr=False)
    off: FloatArray = dataclasses.field(repr=False)
    noise: float
    used: int
    stray: int
    holes: tuple[Hole, ...]
    below: FloatArray = dataclasses.field(repr=False)
    above: FloatArray = dataclasses.field(repr=False)

    def along_z(self, points: FloatArray) -> FloatArray:
        """How far (N,) [m] the scan is above the face, along z, at places (N, 3) [m] of it; NaN where that is
        not known."""
        return _medians(KDTree(self.below), self.above, points)


def of_part(
    cloud: Cloud, part: Part | None, size: FloatArray, marks: ProbedPoints | None, top: bool
) -> tuple[Pose, Deviation]:
    """Where the scan of a formed ``part`` lies, and how far it is off; of its ``top`` or bottom face, in the
    frame of a sheet of ``size`` (3,) [m]. ``marks``: in that frame, and as the scan has them.

    Raises ``TandemError``: scan.unit, scan.flat, scan.other_part, and of marks align.*.
    """
    if part is None or part.formed is None:
        what = "the part of this problem is not formed of a sheet: a scan has nothing to be held against"
        raise TandemError(Issue("scan.other_part", what, hint="name the result folder of a forming job"))
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
    above = distance / up
    # where what comes back differs along a wall, a point's foot has another share of it than what is below
    down = np.array([0.0, 0.0, -1.0])
    below = there[near][own] + above[:, None] * down
    _, left, _, steep = _feet(face, below)  # on curved faces: one step of Newton's
    step = left / np.maximum(steep, LEAST_UP)
    above, below = above + step, below + step[:, None] * down
    place, normal, spacing = _places(face)
    _require_part(face, there[near], foot, distance, _share_of_depth(place, there[near], level))
    tree = KDTree(foot)
    off = _medians(tree, distance, place)
    known = np.isfinite(off)
    if known.mean() < LEAST_SHARE:
        share = f"{100.0 * known.mean():.0f} % of the wanted face"
        what = f"the scan shows {share}, allowed {100.0 * LEAST_SHARE:g} % or more"
        raise TandemError(Issue("scan.other_part", what, hint="scan the whole part, from the side of --face"))
    around = off[known][KDTree(place[known]).query(foot)[1]]
    rest = np.abs(distance - around)
    noise = MAD * float(np.median(rest))
    stray = rest > max(STRAY * noise, LEAST_STRAY)
    return Deviation(
        face,
        place,
        normal,
        off,
        noise,
        len(near),
        int(stray.sum()) + int((~own).sum()),
        tuple(_holes(place[~known], spacing)),
        below[~stray],
        above[~stray],
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


def _medians(tree: KDTree, value: FloatArray, places: FloatArray) -> FloatArray:
    """Medians (M,) of the values of the nearest feet around places (M, 3), NaN where there are few."""
    out, spread = np.full(len(places), np.nan), np.full(len(places), np.inf)
    count = min(NEAREST, len(value))
    for begin in range(0, len(places) if count else 0, AT_ONCE):
        some = slice(begin, begin + AT_ONCE)
        _, found = tree.query(places[some], k=[*range(1, count + 1)], distance_upper_bound=AROUND)
        there = found < len(value)
        near = np.where(there, value[np.minimum(found, len(value) - 1)], np.nan)
        rows = np.flatnonzero(there.sum(axis=1) >= LEAST_FEET)
        middle = np.nanmedian(near[rows], axis=1)
        out[begin + rows] = middle
        spread[begin + rows] = np.nanmedian(np.abs(near[rows] - middle[:, None]), axis=1)
    # in a hole there are stray points alone, which agree on nothing
    out[spread > SPREAD * float(np.median(spread)) + LEAST_SPREAD] = np.nan
    return out


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
    face: TriangleMesh, points: FloatArray, foot: FloatArray, distance: FloatArray, deep: float
) -> None:
    """Raise ``TandemError`` (scan.other_part) where a scan does not look like the wanted part at all."""
    typical = float(np.median(np.abs(distance))) if len(distance) else np.inf
    share = len(foot) / max(len(points), 1)
    if share >= 0.5 and typical <= MEDIAN_MOST and LEAST_DEEP <= deep <= MOST_DEEP:
        turned = _mirrored(face, points) if typical > 1.0 * MM else np.inf
        if turned >= MIRRORED * typical:
            return
    turned = _mirrored(face, points)
    like = turned < MIRRORED * min(typical, FARTHEST)
    what = (
        f"half of the scan is farther than {typical / MM:.1f} mm off the wanted face"
        if np.isfinite(typical)
        else "no point of the scan is near the wanted face"
    )
    what += (
        f", {100.0 * (1.0 - share):.0f} % farther than {FARTHEST / MM:g} mm; it is {deep:.2g} times as deep"
    )
    what += f"; mirrored it would be {turned / MM:.2f} mm off" if like else ""
    hint = "name the result folder of the part that was scanned, say which face it shows (--face), give marks"
    if like:
        hint = "look for an axis with the wrong sign in scan and marks, or swapped columns"
    raise TandemError(Issue("scan.other_part", what, hint=hint))


def _mirrored(face: TriangleMesh, points: FloatArray) -> float:
    """By how much [m] half of the mirror images of points are off a face, of the two across its plane's axes
    the nearer one."""
    some = points[:: max(1, len(points) // 5_000)]
    values = []
    for axis in (0, 1):
        image = some.copy()
        image[:, axis] *= -1.0
        values.append(float(np.median(np.abs(_feet(face, image)[1]))) if len(some) else np.inf)
    return min(values)


def _beside(found: Deviation) -> tuple[FloatArray, float]:
    """How far (2,) [m] to the side a scan would lie if that were all, by least squares, and what share of
    the sum of squares of what it is off this explains."""
    known = np.isfinite(found.off)
    off, normal = found.off[known], found.normal[known, :2]
    if len(off) < len(found.off) // 2:
        return np.zeros(2), 0.0
    move = np.linalg.lstsq(normal, off, rcond=None)[0]
    left = off - normal @ move
    return np.asarray(move, dtype=np.float64), 1.0 - float(left @ left) / max(float(off @ off), 1e-30)


def issues(found: Deviation, pose: Pose, file: str) -> list[Issue]:
    """What a user has to know of a scan: where it lies, what is stray, what is missing."""
    out = []
    if not pose.marks:
        what = (
            f"{file}: no marks are given: the scan is taken to lie in the sheet's frame, but for its height "
            "and tilt, which the flat around the part says"
        )
        beside, share = _beside(found)
        if share > SIDEWAYS_SHARE and np.hypot(*beside) > SIDEWAYS:
            x, y = beside / MM
            what += (
                f"; {100.0 * share:.0f} % of what it is off (squared) is as if it lay ({x:.2f}, {y:.2f}) mm "
                "beside the part"
            )
        hint = "give three marks or more (--marks), unless the scanner is calibrated to the sheet's frame"
        out.append(Issue("scan.no_marks", what, Severity.WARNING, hint=hint))
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
