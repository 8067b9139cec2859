"""Deviation of a scan from the nominal face along its normal, at sampled places of the face.

Missing regions and stray points are reported, too.

Each point of the scan has a foot point, the nearest point of the face, and a signed distance along the normal
there. The deviation at a place is estimated robustly from the nearest foot points: a tenth of stray points
hardly changes it. A place without foot points is part of a hole. Points far from those around them are stray.
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
"""Distance [m] from the nominal face beyond which points do not belong to the part: they are stray."""
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
"""Maximum number of foot points that determine the deviation at a place, nearest first."""
MIN_FOOT_POINTS: Final = 5
"""Minimum number of foot points with which the deviation at a place is known."""
MIN_PLANE_POINTS: Final = 12
"""Minimum number of foot points through which a plane is fitted. With fewer, their median is used."""
ONE_SIDE: Final = 0.5 * MM
"""Maximum distance [m] of the foot points' centroid from the place, for a plane; else the median is used."""
PLANE_ROUNDS: Final = 5
"""Number of rounds of the plane fit."""
WIDE: Final = 2.0
"""Number of standard deviations from the plane at which a foot point has a quarter of its weight."""
MIN_SCALE_M: Final = 1e-6
"""Minimum standard deviation [m] in the plane fit."""
RIDGE: Final = 1e-3
"""Ridge weight of a plane's tilt, as a fraction of the weight of foot points at `NEIGHBOUR_DISTANCE_M`."""
SPREAD: Final = 5.0
"""Factor on the median spread of foot points above which the deviation at a place is unknown."""
MIN_SPREAD_M: Final = 0.05 * MM
"""Spread [m] that is added to that limit."""
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
"""Minimum fraction of the places of the nominal face whose deviation is known."""
MAX_NAMED_HOLES: Final = 8
"""Maximum number of holes that are named."""
MEDIAN_MOST: Final = 6.0 * MM
"""Median deviation [m] above which the scan shows another part."""
MIN_DEPTH_RATIO: Final = 0.4
"""Minimum ratio of the scanned depth of a part to its nominal depth."""
MAX_DEPTH_RATIO: Final = 1.3
"""Maximum ratio of the scanned depth of a part to its nominal depth."""
MIN_CHECKED_DEPTH_M: Final = 0.5 * MM
"""Nominal depth [m] below which the depth of a face is not checked."""
DEPTHS: Final = 20
"""Number of bins of places by nominal depth, within which springback is similar."""
MAX_DEPTH_SPREAD: Final = 0.3
"""Maximum RMS spread of scanned depths within a bin, as a fraction of the depth."""
MIRRORED: Final = 0.3
"""Ratio of the deviation of a mirror image to that of the scan below which the scan is mirrored."""


@dataclasses.dataclass(frozen=True, eq=False)
class Hole:
    """A region of the face without points of the scan.

    Attributes:
        position: Centre (3,) [m] of its bounding box.
        across: Longest side [m] of its bounding box.
    """

    position: FloatArray
    across: float


@dataclasses.dataclass(frozen=True, eq=False)
class Deviation:
    """Deviation of a scan at M places of the nominal face.

    Attributes:
        face: Nominal face.
        point: Places (M, 3) [m].
        normal: Upward normals (M, 3) there.
        deviation: Deviations (M,) [m] along the normal, NaN where unknown.
        noise: Standard deviation [m] of the scan's points.
        used: Number of points that were used.
        stray: Number of stray points.
        holes: Holes, largest first.
        seen: Points (K, 3) [m] of the part that are not stray, in the sheet's frame.
        rise: Their approximate heights (K,) [m] above the face along z: distance over cosine of the wall
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
        """Return the height (N,) [m] of the scan above points (N, 3) [m] of the face, along z, or NaN."""
        tree, heights = self._heights
        return _estimate_places(tree, heights, points).value

    def nearest(self, points: FloatArray) -> FloatArray:
        """Return the points (N, 3) [m] of the face that are nearest to points (N, 3) [m]."""
        return _foot_points(self.face, points)[0]

    @functools.cached_property
    def _heights(self) -> tuple[KDTree, FloatArray]:
        """Projections of ``seen`` onto the face along z, as a tree, and their heights (K,) [m] above it."""
        # springback varies along a wall, so it differs between a foot point and the point below
        down = np.array([0.0, 0.0, -1.0])
        below = self.seen + self.rise[:, None] * down
        # one Newton step along z, because the face may be curved between foot point and projection
        _, distance, _, normal_z = _foot_points(self.face, below)
        step = distance / np.maximum(normal_z, MIN_UP)
        return KDTree(below + step[:, None] * down), self.rise + step


def of_part(
    cloud: Cloud, part: Part | None, size: FloatArray, marks: ProbedPoints | None, top: bool
) -> tuple[ScanPose, Deviation]:
    """Register the scan of a formed part, and compute its deviation from the nominal face.

    Args:
        cloud: Points of the scan.
        part: Formed part of the problem.
        size: Size (3,) [m] of the sheet, in whose frame the result is.
        marks: Marks in the sheet's frame and in the scan.
        top: Whether the top face was scanned.

    Raises:
        TandemError: ``scan.unit`` if the scan has another size than the sheet; ``scan.flat`` if it shows too
            little of the flat; ``scan.other_part`` if it does not show this part; ``align.*`` for wrong
            marks.
    """
    if part is None or part.formed is None:
        message = "the part of this problem is not a formed sheet, so there is no face to compare a scan with"
        raise issue_error("scan.other_part", message, hint="name the result folder of a forming job")
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
    """Compute the deviation of a scan from a nominal face, at places spread over the face.

    The foot of each scanned point on the face is searched. A robust plane through the distances of nearby
    points gives the deviation of a place. Stray points are counted and left out.

    Args:
        points: Points (N, 3) [m] of the scan.
        pose: Pose of the scan.
        face: Nominal face with upward normals, in the sheet's frame.
        level: Height [m] of the flat around it.

    Raises:
        TandemError: ``scan.other_part`` if the scan shows another part, too little of it, or this one
            mirrored.
    """
    moved_points = transform(pose.matrix, points)
    outline = shapely.convex_hull(shapely.multipoints(face.vertices[:, :2]))
    shapely.prepare(outline)
    low, high = face.vertices[:, 2].min() - FARTHEST, face.vertices[:, 2].max() + FARTHEST
    candidates = np.flatnonzero((moved_points[:, 2] >= low) & (moved_points[:, 2] <= high))
    candidates = candidates[
        shapely.contains_xy(outline, moved_points[candidates, 0], moved_points[candidates, 1])
    ]
    # -(-a // b) is a / b rounded up: every n-th point, so that at most MAX_POINTS remain
    candidates = candidates[:: max(1, -(-len(candidates) // MAX_POINTS))]
    foot, distance, across, up = _foot_points(face, moved_points[candidates])
    # points beside the face are excluded: they are on the flat beside a concave outline
    is_over = across <= MAX_LATERAL_RATIO * np.abs(distance)
    candidates, foot, distance, up = candidates[is_over], foot[is_over], distance[is_over], up[is_over]
    is_on_part = np.abs(distance) <= FARTHEST
    foot, distance, up = foot[is_on_part], distance[is_on_part], np.maximum(up[is_on_part], MIN_UP)
    place, normal, spacing = _sample_face(face)
    _require_part(
        face,
        moved_points[candidates],
        foot,
        distance,
        _depth_ratio(place, moved_points[candidates], level),
        level,
    )
    tree = KDTree(foot)
    estimates = _estimate_places(tree, distance, place)
    heights = estimates.value
    is_known = np.isfinite(heights)
    if is_known.mean() < MIN_KNOWN_FRACTION:
        known_text = f"{100.0 * is_known.mean():.0f} % of the nominal face"
        message = f"the scan shows {known_text}, allowed {100.0 * MIN_KNOWN_FRACTION:g} % or more"
        raise issue_error("scan.other_part", message, hint="scan the whole part, from the side of --face")
    _require_shape(place[is_known], normal[is_known], heights[is_known], level)
    nearest = np.flatnonzero(is_known)[KDTree(place[is_known]).query(foot)[1]]
    # springback may vary between a foot point and the nearest place, so the estimate there is tilted
    lateral = foot - place[nearest]
    residual = np.abs(distance - heights[nearest] - dots(estimates.tilt[nearest], lateral))
    noise = MAD * float(np.median(residual))
    is_stray = residual > np.maximum(max(STRAY * noise, MIN_STRAY_M), SPREAD * estimates.spread[nearest])
    return Deviation(
        face,
        place,
        normal,
        heights,
        noise,
        len(candidates),
        int(is_stray.sum()) + int((~is_on_part).sum()),
        tuple(_holes(place[~is_known], spacing)),
        moved_points[candidates][is_on_part][~is_stray],
        (distance / up)[~is_stray],
    )


def _foot_points(
    face: TriangleMesh, points: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the foot points of points (N, 3) [m] on a face, with distances and normals.

    Returns:
        Foot points (N, 3) [m], signed distances (N,) [m], lateral distances (N,) [m] and z components of
            normals (N,). The lateral distance, across the normal, is not 0 for points beyond an edge of the
            face.
    """
    queries = MeshDistance(face, SPACING)
    foot = np.empty_like(points)
    signed_distance, lateral, normal_z = np.empty((3, len(points)))
    for begin in range(0, len(points), BATCH_SIZE):
        batch = slice(begin, begin + BATCH_SIZE)
        distance, index = queries.distance(points[batch])
        corners = face.vertices[face.faces[index]]
        weight = closest_weights(points[batch], *(corners[:, k] for k in range(3)))
        foot[batch] = np.einsum("nk,nkx->nx", weight, corners)
        along = np.einsum("nx,nx->n", points[batch] - foot[batch], queries.normals[index])
        lateral[batch] = np.sqrt(np.maximum(distance**2 - along**2, 0.0))
        signed_distance[batch] = np.where(along >= 0.0, distance, -distance)
        normal_z[batch] = queries.normals[index, 2]
    return foot, signed_distance, lateral, normal_z


def _sample_face(face: TriangleMesh) -> tuple[FloatArray, FloatArray, float]:
    """Return places (M, 3) [m] all over a face, normals (M, 3) there, and the spacing [m] of places."""
    a, b, c = (face.vertices[face.faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    area = float(np.linalg.norm(cross, axis=1).sum()) / 2.0
    spacing = max(SPACING, float(np.sqrt(area / MAX_PLACES)))
    pieces, owner = bisect_triangles(face.vertices[face.faces], spacing * np.sqrt(2.0), 4 * MAX_PLACES)
    middle = pieces.mean(axis=1)
    # keep one place per cubic cell, because regions of small triangles have many pieces in one
    cell = np.floor(middle / spacing).astype(np.int64)
    _, first = np.unique(cell, axis=0, return_index=True)
    first.sort()
    normal = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)
    return middle[first], normal[owner[first]], spacing


@dataclasses.dataclass(frozen=True, eq=False)
class _PlaceEstimates:
    """Estimates from foot points around M places.

    Attributes:
        value: Estimated values (M,), NaN where unknown.
        tilt: Gradients (M, 3) of the values; 0 if no plane was fitted.
        spread: Median absolute residuals (M,) of the foot points; infinite without enough of them.
    """

    value: FloatArray
    tilt: FloatArray
    spread: FloatArray


def _estimate_places(tree: KDTree, value: FloatArray, positions: FloatArray) -> _PlaceEstimates:
    """Estimate values at places (M, 3) [m] from the values (K,) of the foot points in ``tree``.

    The estimate is that of a robust plane through the nearest foot points. If there are fewer than
    ``MIN_PLANE_POINTS``, or if all are on one side, it is their median. With fewer than ``MIN_FOOT_POINTS``,
    or if the values nearby do not agree, the estimate is NaN.
    """
    out, spread = np.full(len(positions), np.nan), np.full(len(positions), np.inf)
    tilt = np.zeros((len(positions), 3))
    count = min(NEAREST, len(value))
    for begin in range(0, len(positions) if count else 0, BATCH_SIZE):
        batch = positions[begin : begin + BATCH_SIZE]
        _, neighbours = tree.query(batch, k=[*range(1, count + 1)], distance_upper_bound=NEIGHBOUR_DISTANCE_M)
        is_known: BoolArray = np.asarray(neighbours < len(value))  # missing neighbours have the index K
        neighbours = np.minimum(neighbours, len(value) - 1)
        near = np.where(is_known, value[neighbours], np.nan)
        offsets = np.where(is_known[:, :, None], tree.data[neighbours] - batch[:, None], 0.0)
        foot_count = is_known.sum(axis=1)
        places = np.flatnonzero(foot_count >= MIN_FOOT_POINTS)
        median = np.nanmedian(near[places], axis=1)
        out[begin + places] = median
        spread[begin + places] = np.nanmedian(np.abs(near[places] - median[:, None]), axis=1)
        places = np.flatnonzero(foot_count >= MIN_PLANE_POINTS)
        height, tilt[begin + places], spread[begin + places] = _fit_plane(offsets[places], near[places])
        # if all foot points lie on one side, a plane would extrapolate into a hole
        is_centred = lengths(offsets[places].sum(axis=1)) <= ONE_SIDE * foot_count[places]
        out[begin + places[is_centred]] = height[is_centred]
    # in a hole there are only stray points, which do not agree
    out[spread > SPREAD * float(np.median(spread)) + MIN_SPREAD_M] = np.nan
    return _PlaceEstimates(out, tilt, spread)


def _fit_plane(offsets: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fit M robust planes by iteratively reweighted least squares with the weights of Geman and McClure.

    The fit starts from the median of the values of each plane.

    Args:
        offsets: Offsets (M, K, 3) [m] of the values of each plane from its centre.
        value: Values (M, K), NaN where there is none.

    Returns:
        Heights (M,) of the planes at their centres, tilts (M, 3), and median absolute residuals (M,).
    """
    is_known: BoolArray = np.asarray(np.isfinite(value))
    known_values = np.where(is_known, value, 0.0)
    # columns of the design matrix: 1 and the offset, scaled
    column = np.concatenate([np.ones((*value.shape, 1)), offsets / NEIGHBOUR_DISTANCE_M], axis=2)
    residuals = known_values - np.nanmedian(value, axis=1)[:, None]
    coefficients = np.zeros((len(value), 4))
    for _ in range(PLANE_ROUNDS):
        weight = (
            is_known
            / (1.0 + (residuals / (WIDE * MAD * _median_absolute(residuals, is_known)[:, None])) ** 2) ** 2
        )
        normal_matrix = np.einsum("mk,mki,mkj->mij", weight, column, column)
        # foot points lie on the face, so they carry no information along its normal
        normal_matrix += RIDGE * weight.sum(axis=1)[:, None, None] * np.diag([0.0, 1.0, 1.0, 1.0])
        right_side = np.einsum("mk,mki,mk->mi", weight, column, known_values)
        coefficients = np.linalg.solve(normal_matrix, right_side[:, :, None])[:, :, 0]
        residuals = known_values - np.einsum("mki,mi->mk", column, coefficients)
    return (
        coefficients[:, 0],
        coefficients[:, 1:] / NEIGHBOUR_DISTANCE_M,
        _median_absolute(residuals, is_known),
    )


def _median_absolute(residuals: FloatArray, is_known: BoolArray) -> FloatArray:
    """Return the median absolute value (M,) of known residuals (M, K), plus `MIN_SCALE_M`."""
    return np.asarray(np.nanmedian(np.where(is_known, np.abs(residuals), np.nan), axis=1) + MIN_SCALE_M)


def _holes(bare: FloatArray, spacing: float) -> list[Hole]:
    """Return the holes, largest first: connected groups of places (K, 3) [m] without nearby points."""
    if not len(bare):
        return []
    pairs: IntArray = KDTree(bare).query_pairs(2.0 * spacing, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(bare), len(bare)))
    count, label = connected_components(graph, directed=False)
    holes = []
    for k in range(count):
        places = bare[label == k]
        if len(places) >= HOLE:
            low, high = places.min(axis=0), places.max(axis=0)
            holes.append(Hole(0.5 * (low + high), float((high - low).max()) + spacing))
    return sorted(holes, key=lambda hole: -hole.across)


def _depth_ratio(positions: FloatArray, points: FloatArray, level: float) -> float:
    """Return the median ratio of the depth of points (N, 3) [m] to the nominal depth at the same x and y.

    Depths count from the ``level`` [m]; ``positions`` (M, 3) [m] are places of the face. Only deep places
    count.
    """
    sample = points[:: max(1, len(points) // 20_000)]
    nominal_depth = positions[KDTree(positions[:, :2]).query(sample[:, :2])[1], 2] - level
    is_deep = np.abs(nominal_depth) > max(
        0.2 * float(np.abs(nominal_depth).max(initial=0.0)), MIN_CHECKED_DEPTH_M
    )
    return float(np.median((sample[is_deep, 2] - level) / nominal_depth[is_deep])) if is_deep.any() else 1.0


def _require_part(
    face: TriangleMesh, points: FloatArray, foot: FloatArray, distance: FloatArray, depth: float, level: float
) -> None:
    """Raise ``scan.other_part`` if a scan does not show the nominal part, or shows its mirror image.

    The part is plausible if half of the points are near the face, their median distance is small, and the
    depth is about the nominal one. A plausible part with a median distance of at most 1 mm is accepted at
    once. Otherwise the mirror image must not fit much better.

    ``points`` (N, 3) [m] are above or below the face; ``foot`` (K, 3) and ``distance`` (K,) [m] are the foot
    points and distances of those near it; ``depth`` is the ratio of scanned to nominal depth, ``level`` [m]
    the flat.
    """
    typical = float(np.median(np.abs(distance))) if len(distance) else np.inf
    near_fraction = len(foot) / max(len(points), 1)
    is_plausible = (
        near_fraction >= 0.5 and typical <= MEDIAN_MOST and MIN_DEPTH_RATIO <= depth <= MAX_DEPTH_RATIO
    )
    if is_plausible and typical <= 1.0 * MM:
        return
    mirrored_deviation, axis = _mirrored(face, points, level)
    is_mirrored = mirrored_deviation < MIRRORED * min(typical, FARTHEST)
    if is_plausible and not is_mirrored:
        return
    message = (
        f"half of the scan is farther than {typical / MM:.1f} mm from the nominal face"
        if np.isfinite(typical)
        else "no point of the scan is near the nominal face"
    )
    message += (
        f", {100.0 * (1.0 - near_fraction):.0f} % farther than {FARTHEST / MM:g} mm; it is {depth:.2g} times "
        f"as deep, allowed {MIN_DEPTH_RATIO:g} to {MAX_DEPTH_RATIO:g}"
        if len(points)
        else ": it shows only the flat around the part"
    )
    hint = "name the result folder of the scanned part, state which face it shows (--face), give marks"
    if is_mirrored:
        message += f"; mirrored along {axis} it would be {mirrored_deviation / MM:.2f} mm off"
        hint = "check scan and marks for an axis with the wrong sign, or swapped columns"
    raise issue_error("scan.other_part", message, hint=hint)


def _require_shape(positions: FloatArray, normal: FloatArray, heights: FloatArray, level: float) -> None:
    """Require that places of similar nominal depth have similar depths in the scan.

    Springback mainly depends on depth. In a scan of another part, depths at such places differ.

    ``heights`` (M,) [m] are the deviations at places ``positions`` (M, 3) [m], ``level`` [m] is the flat.
    Raises ``scan.other_part`` if they have not.
    """
    nominal_depth = positions[:, 2] - level
    scanned_depth = nominal_depth + heights / np.maximum(normal[:, 2], MIN_UP)
    mean_square = float(np.mean(scanned_depth**2))
    if mean_square < MIN_CHECKED_DEPTH_M**2:
        return
    bins = np.array_split(scanned_depth[np.argsort(nominal_depth, kind="stable")], DEPTHS)
    spread = float(
        np.sqrt(
            sum(((depths - depths.mean()) ** 2).sum() for depths in bins if len(depths)) / len(scanned_depth)
        )
    )
    spread_ratio = spread / float(np.sqrt(mean_square))
    if spread_ratio <= MAX_DEPTH_SPREAD:
        return
    message = (
        f"places of the same nominal depth differ by {spread / MM:.1f} mm (RMS) in the scan's depth, "
        f"{100.0 * spread_ratio:.0f} % of it, allowed {100.0 * MAX_DEPTH_SPREAD:g} %: it has the shape of "
        "another part or is misplaced"
    )
    hint = "name the result folder of the scanned part, give marks, or measure them again"
    raise issue_error(
        "scan.other_part", message, value=100.0 * spread_ratio, limit=100.0 * MAX_DEPTH_SPREAD, hint=hint
    )


def _mirrored(face: TriangleMesh, points: FloatArray, level: float) -> tuple[float, str]:
    """Return the smallest median deviation [m] of a scan's mirror images along x, y and z, and its axis.

    The mirror plane across z is at ``level`` [m]. It matters because marks in a plane also fit a scan that is
    mirrored and turned over.
    """
    sample = points[:: max(1, len(points) // 5_000)]
    if not len(sample):
        return np.inf, "x"
    values = []
    for axis in range(3):
        image = sample.copy()
        image[:, axis] *= -1.0
        image[:, axis] += 2.0 * level if axis == 2 else 0.0
        values.append(float(np.median(np.abs(_foot_points(face, image)[1]))))
    return min(zip(values, "xyz", strict=True))


def issues(measured: Deviation, file: str) -> list[Issue]:
    """Return the issues of a scan apart from its pose: stray points and holes."""
    out = []
    if measured.stray:
        fraction = measured.stray / measured.used
        message = (
            f"{file}: {measured.stray} of {measured.used} points ({100.0 * fraction:.1f} %) are stray and "
            "ignored"
        )
        out.append(Issue("scan.stray", message, Severity.WARNING if fraction > 0.2 else Severity.NOTE))
    missing = float((~np.isfinite(measured.deviation)).mean())
    for hole in measured.holes[:MAX_NAMED_HOLES]:
        x, y, z = hole.position / MM
        message = f"{file}: a hole {hole.across / MM:.0f} mm across at ({x:.0f}, {y:.0f}, {z:.0f}) mm"
        out.append(Issue("scan.hole", message, Severity.WARNING, value=hole.across / MM, unit="mm"))
    if len(measured.holes) > MAX_NAMED_HOLES:
        remaining = len(measured.holes) - MAX_NAMED_HOLES
        message = f"{file}: {remaining} more holes; in all {100.0 * missing:.1f} % of the face is missing"
        out.append(Issue("scan.hole", message, Severity.WARNING))
    return out
