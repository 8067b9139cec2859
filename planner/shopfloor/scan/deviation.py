"""Deviation of a scan from the nominal face along its normal, place by place.

It includes what is missing and stray.

Each point of the scan has a foot point, the nearest point of the face, and a signed distance along the normal
there. A place of the face gets a robust value of the nearest foot points around it, which a tenth of stray
points hardly moves. A place without foot points is part of a hole. Points far from those around them are
reported as stray.
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
from planner.geometry.mesh import TriangleMesh, bisect_triangles, closest_weights
from planner.geometry.mesh_queries import MeshDistance
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Severity, issue_error
from planner.problem import Part
from planner.shopfloor.align.probing import ProbedPoints
from planner.shopfloor.scan.cloud import Cloud, require_size
from planner.shopfloor.scan.registration import MAD, Flat, ScanPose, register

RIM: Final = 8.0 * MM
"""Width [m] of the sheet around the part's outline that bends with it and is not used for registration."""
FARTHEST: Final = 15.0 * MM
"""Distance [m] from the nominal face beyond which points do not belong to the part."""
MAX_LATERAL_RATIO: Final = 0.94
"""Ratio of lateral distance to distance above which points are beside the face, not above or below it: their
direction is inclined by 70 degrees to the normal.
"""
MIN_UP: Final = float(np.cos(80.0 * DEG))
"""Minimum z component of the normal with which a deviation is converted to z, for walls of up to 80
degrees.
"""
SPACING: Final = 2.0 * MM
"""Distance [m] between places of the face; larger if there would be too many."""
MAX_PLACES: Final = 30_000
"""Approximate maximum number of places of the face."""
NEIGHBOUR_DISTANCE_M: Final = 2.0 * MM
"""Distance [m] from a place within which foot points determine its deviation."""
NEAREST: Final = 31
"""Maximum number of these, nearest first."""
MIN_FOOT_POINTS: Final = 5
"""Minimum number of foot points of a known place."""
MIN_PLANE_POINTS: Final = 12
ONE_SIDE: Final = 0.5 * MM
"""Minimum number of foot points for a plane, and largest distance [m] of their centre; otherwise their median
is used.
"""
PLANE_ROUNDS: Final = 5
WIDE: Final = 2.0
MIN_SCALE_M: Final = 1e-6
"""Parameters of the plane fit: number of rounds; number of standard deviations at which foot points count a
quarter; minimum standard deviation [m].
"""
RIDGE: Final = 1e-3
"""Weight that pulls the tilt to 0, as a fraction of the weight of foot points at `NEIGHBOUR_DISTANCE_M`."""
SPREAD: Final = 5.0
"""Factor of the usual spread of foot points above which a place is unknown."""
MIN_SPREAD_M: Final = 0.05 * MM
"""Minimum spread [m] in addition."""
MAX_POINTS: Final = 400_000
"""Maximum number of points that are compared with the face. Larger scans are decimated."""
BATCH_SIZE: Final = 50_000
"""Number of points that are processed together."""
STRAY: Final = 6.0
"""Number of standard deviations from the surrounding points above which points are stray."""
MIN_STRAY_M: Final = 0.2 * MM
"""Minimum deviation [m] of stray points."""
HOLE: Final = 3
"""Minimum number of adjacent places without foot points that form a hole."""
MIN_KNOWN_FRACTION: Final = 0.4
"""Minimum fraction of the nominal face that is known."""
MAX_NAMED_HOLES: Final = 8
"""Maximum number of holes that are named."""
MEDIAN_MOST: Final = 6.0 * MM
"""Median deviation [m] above which the scan shows another part."""
MIN_DEPTH_RATIO: Final = 0.4
MAX_DEPTH_RATIO: Final = 1.3
"""Allowed ratio of the depth of a part to its nominal depth."""
MIN_CHECKED_DEPTH_M: Final = 0.5 * MM
"""Nominal depth [m] below which the depth of a face is not checked."""
DEPTHS: Final = 20
"""Number of bins of places by nominal depth, between which springback differs."""
MAX_DEPTH_SPREAD: Final = 0.3
"""Maximum RMS spread of scanned depths within a bin, as a fraction of the depth."""
MIRRORED: Final = 0.3
"""Ratio of the deviation of a mirror image to that of the scan below which the scan is mirrored."""


@dataclasses.dataclass(frozen=True, eq=False)
class Hole:
    """A part of the face without points of the scan, around ``position`` (3,) [m], ``across`` [m] wide."""

    position: FloatArray
    across: float


@dataclasses.dataclass(frozen=True, eq=False)
class Deviation:
    """Deviation of a scan at M places of the nominal face.

    Attributes:
        face: Nominal face.
        point: (M, 3) [m] places.
        normal: (M, 3) upward normals.
        deviation: (M,) [m] along the normal, NaN where unknown.
        noise: Standard deviation [m] of the scan's points.
        used: Number of points that were used.
        stray: Number of stray points.
        holes: Holes, largest first.
        seen: (K, 3) points of the part that are not stray, in the sheet's frame.
        rise: (K,) [m] their approximate height above the face along z: deviation over cosine of the wall
            angle.
    """

    face: TriangleMesh = dataclasses.field(repr=False)
    point: FloatArray = dataclasses.field(repr=False)
    normal: FloatArray = dataclasses.field(repr=False)
    deviation: FloatArray = dataclasses.field(repr=False)
    noise: float
    used: int
    stray: int
    holes: tuple[Hole, ...]
    seen: FloatArray = dataclasses.field(repr=False)
    rise: FloatArray = dataclasses.field(repr=False)

    def along_z(self, points: FloatArray) -> FloatArray:
        """Height (N,) [m] of the scan above the face, along z, at places (N, 3) [m]; NaN where unknown."""
        tree, above = self._heights
        return _estimate_places(tree, above, points).value

    def nearest(self, points: FloatArray) -> FloatArray:
        """Nearest points (N, 3) [m] of the face to points (N, 3) [m]."""
        return _foot_points(self.face, points)[0]

    @functools.cached_property
    def _heights(self) -> tuple[KDTree, FloatArray]:
        """Projections of points onto the face along z, and their heights (K,) [m] above it."""
        # springback varies along a wall, so it differs between a foot point and the point below
        down = np.array([0.0, 0.0, -1.0])
        below = self.seen + self.rise[:, None] * down
        _, left, _, steep = _foot_points(self.face, below)  # one Newton step, for curved faces
        step = left / np.maximum(steep, MIN_UP)
        return KDTree(below + step[:, None] * down), self.rise + step


def of_part(
    cloud: Cloud, part: Part | None, size: FloatArray, marks: ProbedPoints | None, top: bool
) -> tuple[ScanPose, Deviation]:
    """Register the scan of a formed part and compute its deviation.

    Args:
        cloud: Points of the scan.
        part: Formed part.
        size: (3,) [m] size of the sheet, in whose frame the result is.
        marks: Marks in the sheet's frame and in the scan.
        top: Whether the top face was scanned.

    Raises:
        TandemError: scan.unit, scan.flat, scan.other_part, and for marks align.*.
    """
    if part is None or part.formed is None:
        what = "the part of this problem is not a formed sheet, so there is no face to compare a scan with"
        raise issue_error("scan.other_part", what, hint="name the result folder of a forming job")
    mesh = part.formed.mesh
    level = float(size[2]) if top else 0.0
    face = TriangleMesh(mesh.vertices + np.array([0.0, 0.0, level]), np.asarray(mesh.faces))
    require_size(cloud, float(size[:2].max()))
    x, y = 0.5 * size[:2]
    formed = shapely.convex_hull(shapely.multipoints(face.vertices[:, :2])).buffer(RIM)
    flat = Flat(shapely.difference(shapely.box(-x, -y, x, y), formed), level, float(size[:2].min()))
    pose = register(cloud.points, flat, marks)
    return pose, deviation(cloud.points, pose, face, level)


def deviation(points: FloatArray, pose: ScanPose, face: TriangleMesh, level: float) -> Deviation:
    """Compute the deviation of a scan from a nominal face.

    Args:
        points: (N, 3) [m] points of the scan.
        pose: Pose of the scan.
        face: Nominal face with upward normals.
        level: Height [m] of the flat.

    Raises:
        TandemError: scan.other_part if the scan shows another part, or this one mirrored.
    """
    moved_points = transform(pose.matrix, points)
    outline = shapely.convex_hull(shapely.multipoints(face.vertices[:, :2]))
    shapely.prepare(outline)
    low, high = face.vertices[:, 2].min() - FARTHEST, face.vertices[:, 2].max() + FARTHEST
    candidates = np.flatnonzero((moved_points[:, 2] >= low) & (moved_points[:, 2] <= high))
    candidates = candidates[
        shapely.contains_xy(outline, moved_points[candidates, 0], moved_points[candidates, 1])
    ]
    candidates = candidates[:: max(1, -(-len(candidates) // MAX_POINTS))]
    foot, distance, across, up = _foot_points(face, moved_points[candidates])
    over = across <= MAX_LATERAL_RATIO * np.abs(
        distance
    )  # excludes the flat beside a face with a concave outline
    candidates, foot, distance, up = candidates[over], foot[over], distance[over], up[over]
    is_on_part = np.abs(distance) <= FARTHEST
    foot, distance, up = foot[is_on_part], distance[is_on_part], np.maximum(up[is_on_part], MIN_UP)
    place, normal, spacing = _sample_face(face)
    _require_part(
        face,
        moved_points[candidates],
        foot,
        distance,
        _share_of_depth(place, moved_points[candidates], level),
        level,
    )
    tree = KDTree(foot)
    estimates = _estimate_places(tree, distance, place)
    heights = estimates.value
    known = np.isfinite(heights)
    if known.mean() < MIN_KNOWN_FRACTION:
        known_text = f"{100.0 * known.mean():.0f} % of the nominal face"
        what = f"the scan shows {known_text}, allowed {100.0 * MIN_KNOWN_FRACTION:g} % or more"
        raise issue_error("scan.other_part", what, hint="scan the whole part, from the side of --face")
    _require_shape(place[known], normal[known], heights[known], level)
    nearest = np.flatnonzero(known)[KDTree(place[known]).query(foot)[1]]
    # springback may change as fast as the position along the wall, so foot points cannot stand for places
    lateral = foot - place[nearest]
    rest = np.abs(distance - heights[nearest] - dots(estimates.tilt[nearest], lateral))
    noise = MAD * float(np.median(rest))
    stray = rest > np.maximum(max(STRAY * noise, MIN_STRAY_M), SPREAD * estimates.spread[nearest])
    return Deviation(
        face,
        place,
        normal,
        heights,
        noise,
        len(candidates),
        int(stray.sum()) + int((~is_on_part).sum()),
        tuple(_holes(place[~known], spacing)),
        moved_points[candidates][is_on_part][~stray],
        (distance / up)[~stray],
    )


def _foot_points(
    face: TriangleMesh, points: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Foot points (N, 3) [m] of points (N, 3) on a face, with distances and normals.

    Also returns signed distances (N,), lateral distances (N,) and normal z (N,). The lateral distance, across
    the normal, is not 0 for points beyond an edge of the face.
    """
    queries = MeshDistance(face, SPACING)
    foot = np.empty_like(points)
    above, lateral, up = np.empty((3, len(points)))
    for begin in range(0, len(points), BATCH_SIZE):
        batch = slice(begin, begin + BATCH_SIZE)
        distance, index = queries.distance(points[batch])
        corners = face.vertices[face.faces[index]]
        weight = closest_weights(points[batch], *(corners[:, k] for k in range(3)))
        foot[batch] = np.einsum("nk,nkx->nx", weight, corners)
        along = np.einsum("nx,nx->n", points[batch] - foot[batch], queries.normals[index])
        lateral[batch] = np.sqrt(np.maximum(distance**2 - along**2, 0.0))
        above[batch] = np.where(along >= 0.0, distance, -distance)
        up[batch] = queries.normals[index, 2]
    return foot, above, lateral, up


def _sample_face(face: TriangleMesh) -> tuple[FloatArray, FloatArray, float]:
    """Places (M, 3) [m] all over a face, their normals (M, 3), and their spacing [m]."""
    a, b, c = (face.vertices[face.faces[:, k]] for k in range(3))
    whole = np.cross(b - a, c - a)
    area = float(np.linalg.norm(whole, axis=1).sum()) / 2.0
    spacing = max(SPACING, float(np.sqrt(area / MAX_PLACES)))
    pieces, owner = bisect_triangles(face.vertices[face.faces], spacing * np.sqrt(2.0), 4 * MAX_PLACES)
    middle = pieces.mean(axis=1)
    # one place per cell: regions of small triangles have many pieces in it
    cell = np.floor(middle / spacing).astype(np.int64)
    _, first = np.unique(cell, axis=0, return_index=True)
    first.sort()
    normal = whole / np.maximum(np.linalg.norm(whole, axis=1, keepdims=True), 1e-300)
    return middle[first], normal[owner[first]], spacing


@dataclasses.dataclass(frozen=True, eq=False)
class _PlaceEstimates:
    """Estimates from foot points around M places.

    Attributes:
        value: (M,) estimates, NaN where unknown.
        tilt: (M, 3) their gradients.
        spread: (M,) median absolute residuals.
    """

    value: FloatArray
    tilt: FloatArray
    spread: FloatArray


def _estimate_places(tree: KDTree, value: FloatArray, positions: FloatArray) -> _PlaceEstimates:
    """Estimate a value (K,) of foot points at places (M, 3): a robust plane through the nearest ones.

    With few foot points, or if all are on one side, the estimate is their median.
    """
    out, spread = np.full(len(positions), np.nan), np.full(len(positions), np.inf)
    tilt = np.zeros((len(positions), 3))
    count = min(NEAREST, len(value))
    for begin in range(0, len(positions) if count else 0, BATCH_SIZE):
        batch = positions[begin : begin + BATCH_SIZE]
        _, found = tree.query(batch, k=[*range(1, count + 1)], distance_upper_bound=NEIGHBOUR_DISTANCE_M)
        is_known: BoolArray = np.asarray(found < len(value))
        found = np.minimum(found, len(value) - 1)
        near = np.where(is_known, value[found], np.nan)
        offsets = np.where(is_known[:, :, None], tree.data[found] - batch[:, None], 0.0)
        feet = is_known.sum(axis=1)
        rows = np.flatnonzero(feet >= MIN_FOOT_POINTS)
        middle = np.nanmedian(near[rows], axis=1)
        out[begin + rows] = middle
        spread[begin + rows] = np.nanmedian(np.abs(near[rows] - middle[:, None]), axis=1)
        rows = np.flatnonzero(feet >= MIN_PLANE_POINTS)
        height, tilt[begin + rows], spread[begin + rows] = _fit_plane(offsets[rows], near[rows])
        # where all of them lie on one side, a plane would extrapolate into a hole
        even = lengths(offsets[rows].sum(axis=1)) <= ONE_SIDE * feet[rows]
        out[begin + rows[even]] = height[even]
    # in a hole there are only stray points, which do not agree
    out[spread > SPREAD * float(np.median(spread)) + MIN_SPREAD_M] = np.nan
    return _PlaceEstimates(out, tilt, spread)


def _fit_plane(offsets: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Heights (M,) of robust planes at their centres, tilts (M, 3), and median absolute residuals (M,).

    The planes pass through ``value`` (M, K), NaN where there is none, at offsets (M, K, 3) [m]. Iteratively
    reweighted least squares with the weights of Geman and McClure.
    """
    is_known: BoolArray = np.asarray(np.isfinite(value))
    known = np.where(is_known, value, 0.0)
    column = np.concatenate([np.ones((*value.shape, 1)), offsets / NEIGHBOUR_DISTANCE_M], axis=2)
    residuals = known - np.nanmedian(value, axis=1)[:, None]
    found = np.zeros((len(value), 4))
    for _ in range(PLANE_ROUNDS):
        weight = (
            is_known / (1.0 + (residuals / (WIDE * MAD * _typical(residuals, is_known)[:, None])) ** 2) ** 2
        )
        whole = np.einsum("mk,mki,mkj->mij", weight, column, column)
        # foot points lie on the face, so they carry no information along its normal
        whole += RIDGE * weight.sum(axis=1)[:, None, None] * np.diag([0.0, 1.0, 1.0, 1.0])
        right = np.einsum("mk,mki,mk->mi", weight, column, known)
        found = np.linalg.solve(whole, right[:, :, None])[:, :, 0]
        residuals = known - np.einsum("mki,mi->mk", column, found)
    return found[:, 0], found[:, 1:] / NEIGHBOUR_DISTANCE_M, _typical(residuals, is_known)


def _typical(heights: FloatArray, positions: BoolArray) -> FloatArray:
    return np.asarray(np.nanmedian(np.where(positions, np.abs(heights), np.nan), axis=1) + MIN_SCALE_M)


def _holes(bare: FloatArray, spacing: float) -> list[Hole]:
    """Holes, from the places (K, 3) without nearby points."""
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


def _share_of_depth(positions: FloatArray, points: FloatArray, level: float) -> float:
    """Median ratio of the depth of points (N, 3) [m] to that of the face's places (M, 3) at the same x, y.

    Only places off the ``level`` [m] count.
    """
    selected = points[:: max(1, len(points) // 20_000)]
    nominal_depth = positions[KDTree(positions[:, :2]).query(selected[:, :2])[1], 2] - level
    deep = np.abs(nominal_depth) > max(
        0.2 * float(np.abs(nominal_depth).max(initial=0.0)), MIN_CHECKED_DEPTH_M
    )
    return float(np.median((selected[deep, 2] - level) / nominal_depth[deep])) if deep.any() else 1.0


def _require_part(
    face: TriangleMesh, points: FloatArray, foot: FloatArray, distance: FloatArray, deep: float, level: float
) -> None:
    """Raise ``TandemError`` (scan.other_part) if a scan does not look like the nominal part at all."""
    typical = float(np.median(np.abs(distance))) if len(distance) else np.inf
    near_fraction = len(foot) / max(len(points), 1)
    good = near_fraction >= 0.5 and typical <= MEDIAN_MOST and MIN_DEPTH_RATIO <= deep <= MAX_DEPTH_RATIO
    if good and typical <= 1.0 * MM:
        return
    mirrored_deviation, axis = _mirrored(face, points, level)
    like = mirrored_deviation < MIRRORED * min(typical, FARTHEST)
    if good and not like:
        return
    what = (
        f"half of the scan is farther than {typical / MM:.1f} mm from the nominal face"
        if np.isfinite(typical)
        else "no point of the scan is near the nominal face"
    )
    what += (
        f", {100.0 * (1.0 - near_fraction):.0f} % farther than {FARTHEST / MM:g} mm; it is {deep:.2g} times "
        f"as deep, allowed {MIN_DEPTH_RATIO:g} to {MAX_DEPTH_RATIO:g}"
        if len(points)
        else ": it shows only the flat around the part"
    )
    hint = "name the result folder of the scanned part, state which face it shows (--face), give marks"
    if like:
        what += f"; mirrored along {axis} it would be {mirrored_deviation / MM:.2f} mm off"
        hint = "check scan and marks for an axis with the wrong sign, or swapped columns"
    raise issue_error("scan.other_part", what, hint=hint)


def _require_shape(positions: FloatArray, normal: FloatArray, heights: FloatArray, level: float) -> None:
    """Require that places (M, 3) of one nominal depth have similar depths in the scan.

    Springback depends on depth above all, and the shape of another part does not.

    Raises:
        TandemError: They have many depths in the scan (``scan.other_part``).
    """
    nominal_depth = positions[:, 2] - level
    deep = nominal_depth + heights / np.maximum(normal[:, 2], MIN_UP)
    square = float(np.mean(deep**2))
    if square < MIN_CHECKED_DEPTH_M**2:
        return
    bins = np.array_split(deep[np.argsort(nominal_depth, kind="stable")], DEPTHS)
    spread = float(np.sqrt(sum(((one - one.mean()) ** 2).sum() for one in bins if len(one)) / len(deep)))
    spread_ratio = spread / float(np.sqrt(square))
    if spread_ratio <= MAX_DEPTH_SPREAD:
        return
    what = (
        f"places of the same nominal depth differ by {spread / MM:.1f} mm (RMS) in the scan's depth, "
        f"{100.0 * spread_ratio:.0f} % of it, allowed {100.0 * MAX_DEPTH_SPREAD:g} %: it has the shape of "
        "another part or is misplaced"
    )
    hint = "name the result folder of the scanned part, give marks, or measure them again"
    raise issue_error(
        "scan.other_part", what, value=100.0 * spread_ratio, limit=100.0 * MAX_DEPTH_SPREAD, hint=hint
    )


def _mirrored(face: TriangleMesh, points: FloatArray, level: float) -> tuple[float, str]:
    """Smallest median deviation [m] of the mirror images along x, y and z, and its axis.

    The mirror along z is about the ``level``. Marks in a plane fit a mirror image turned over, which is one
    along z.
    """
    some = points[:: max(1, len(points) // 5_000)]
    if not len(some):
        return np.inf, "x"
    values = []
    for axis in range(3):
        image = some.copy()
        image[:, axis] *= -1.0
        image[:, axis] += 2.0 * level if axis == 2 else 0.0
        values.append(float(np.median(np.abs(_foot_points(face, image)[1]))))
    return min(zip(values, "xyz", strict=True))


def issues(measured: Deviation, file: str) -> list[Issue]:
    """Issues of a scan apart from its pose: stray points and holes."""
    out = []
    if measured.stray:
        fraction = measured.stray / measured.used
        what = (
            f"{file}: {measured.stray} of {measured.used} points ({100.0 * fraction:.1f} %) are stray and "
            "ignored"
        )
        out.append(Issue("scan.stray", what, Severity.WARNING if fraction > 0.2 else Severity.NOTE))
    missing = float((~np.isfinite(measured.deviation)).mean())
    for hole in measured.holes[:MAX_NAMED_HOLES]:
        x, y, z = hole.position / MM
        what = f"{file}: a hole {hole.across / MM:.0f} mm across at ({x:.0f}, {y:.0f}, {z:.0f}) mm"
        out.append(Issue("scan.hole", what, Severity.WARNING, value=hole.across / MM, unit="mm"))
    if len(measured.holes) > MAX_NAMED_HOLES:
        more = len(measured.holes) - MAX_NAMED_HOLES
        what = f"{file}: {more} more holes; in all {100.0 * missing:.1f} % of the face is missing"
        out.append(Issue("scan.hole", what, Severity.WARNING))
    return out
