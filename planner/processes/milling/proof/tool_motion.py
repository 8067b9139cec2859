"""Motion and bodies of milling tools in the proof, and the face points that are compared with them.

Tips and axes are in the block's frame, at as few samples of the replay as the motion between them allows. The
tool is a sequence of solids of revolution whose distance from points is computed along a track. The distance
between face points near the tool's path depends on the size of the defects that must be found. Sharp edges
leave narrow grooves, so the points near them are closer.
"""

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.geometry.swept_body import RoundBody, SweptBody, least_distances, points_near
from planner.problem import Stock
from planner.processes.milling.claims import MillsAlong, MillsFlank, MillsOver, MillsSurface, SparesPart
from planner.processes.milling.proof.path_following import PathDeviation, match_path, rows_to_check
from planner.processes.milling.proof.resolve_claims import plunge_claim, retreat_claim
from planner.proof.context import Context
from planner.proof.facts import Fact
from planner.proof.replay.motion import with_start_stations
from planner.proof.replay.tool_track import PathPositions, ReplayedToolPath, tcp_in_stock, tool_path
from planner.runtime.executor import SERIAL, Executor
from planner.tooling import Cutter, Mill

BEND_FRACTION = 0.1
"""Fraction of a tolerance by which straight lines between samples may deviate from a curved path."""


def in_block(tip: FloatArray, axis: FloatArray, length: float, radius: float, stock: Stock) -> BoolArray:
    """Return whether (T,) a cutter, as a sequence of balls along its axis, is in the block.

    Args:
        tip: Tips in the block's frame (T, 3) [m].
        axis: Axes (T, 3).
        length: Length of the cutter [m].
        radius: Radius of the cutter [m].
        stock: The block.
    """
    out = np.zeros(len(tip), dtype=bool)
    for back in np.append(np.arange(0.0, length, max(radius, 1e-3)), length):
        centre = tip + back * axis
        beyond = np.maximum(np.maximum(stock.lower - centre, centre - stock.upper), 0.0)
        # The first ball represents the flat end of the tip, so its radius is almost zero.
        ball_radius = 1e-6 if back == 0.0 else radius
        out |= np.linalg.norm(beyond, axis=1) < min(ball_radius, radius) - 1e-9
    return out


class MillingMotion:
    """Milling in one proof: its claims by setup, and tracks that are computed on demand and cached.

    ``executor`` runs computations that another process may do meanwhile.
    """

    def __init__(self, context: Context, executor: Executor = SERIAL) -> None:
        self.context, self.executor = context, executor
        self.by_setup: tuple[
            tuple[int, MillsSurface | MillsAlong | MillsFlank | MillsOver | SparesPart], ...
        ] = tuple(
            (index, claim)
            for index, setup in enumerate(context.setup_claims)
            for group in setup.groups
            for claim in group
            if isinstance(claim, MillsSurface | MillsAlong | MillsFlank | MillsOver | SparesPart)
        )
        self._tracks: dict[tuple[int, str, tuple[str, ...]], ReplayedToolPath] = {}
        self._spaced: dict[tuple[int, str, tuple[str, ...], float, float], PathPositions] = {}
        self._followed: dict[tuple[int, int], tuple[IntArray, PathDeviation]] = {}

    @property
    def surfaces(self) -> tuple[tuple[int, MillsSurface], ...]:
        """Surfaces that are milled, each with its setup."""
        return tuple((i, claim) for i, claim in self.by_setup if isinstance(claim, MillsSurface))

    @property
    def curves(self) -> tuple[tuple[int, MillsAlong], ...]:
        """Paths that tips follow, each with its setup.

        They include the moves to and from passes over faces, straight along the axis from the safe plane to
        the ends of a pass.
        """
        claimed = [
            (i, self._claim_in_direction(i, claim))
            for i, claim in self.by_setup
            if isinstance(claim, MillsAlong)
        ]
        return (*claimed, *self._face_leads)

    def _claim_in_direction(self, index: int, claim: MillsAlong) -> MillsAlong:
        """Return a claim, or its reverse if both directions are allowed and the tool moves in reverse.

        ``index`` is that of the setup. The direction is the one whose ends are nearer to those of the track.
        """
        track = self.track(index, claim.arm, (claim.segment.key,)) if claim.back else None
        if claim.back is None or track is None or not len(track.rows):
            return claim
        track_ends = track.tip[[0, -1]]
        distances = [
            np.linalg.norm(candidate.tip[[0, -1]] - track_ends, axis=1).sum()
            for candidate in (claim, claim.back)
        ]
        return claim if distances[0] <= distances[1] else claim.back

    @cached_property
    def _face_leads(self) -> tuple[tuple[int, MillsAlong], ...]:
        """Claims on the moves to and from passes over faces, each with its setup.

        They start and end where the pass itself does in the motion.
        """
        out: list[tuple[int, MillsAlong]] = []
        for index, claim in self.faces:
            for segment in claim.segments:
                track = self.track(index, claim.arm, (segment.key,))
                for lead, row in ((plunge_claim, 0), (retreat_claim, -1)) if len(track.rows) else ():
                    out.append((index, lead(claim, segment, track.tip[row], track.axis[row])))
        return tuple(out)

    @property
    def faces(self) -> tuple[tuple[int, MillsOver], ...]:
        """Faces that the ends of cutters pass over, each with its setup."""
        return tuple((i, claim) for i, claim in self.by_setup if isinstance(claim, MillsOver))

    @property
    def flanks(self) -> tuple[tuple[int, MillsFlank], ...]:
        """Ruled surfaces that cutters pass with their sides, each with its setup."""
        return tuple((i, claim) for i, claim in self.by_setup if isinstance(claim, MillsFlank))

    @property
    def spared(self) -> tuple[tuple[int, SparesPart], ...]:
        """Faces that tools must not enter, each with its setup."""
        return tuple((i, claim) for i, claim in self.by_setup if isinstance(claim, SparesPart))

    @cached_property
    def labels(self) -> frozenset[str]:
        """Keys of all segments with a claim on a spared face, a milled surface or a path, leads included."""
        segments: list[Segment] = []
        for _, claim in self.by_setup:
            segments += (claim.segment,) if isinstance(claim, MillsAlong) else claim.segments
        return frozenset(part.key for segment in segments for part in segment.all_phases)

    def mounted_cutter(self, index: int, arm: str) -> Cutter | None:
        """Return the cutter of the tool on ``arm`` in setup ``index``, None if it has none."""
        tool = self.context.setups[index].cell.arm(arm).tool
        return tool.cutter if isinstance(tool, Mill) else None

    def track(self, index: int, arm: str, labels: tuple[str, ...]) -> ReplayedToolPath:
        """Return the track of an arm.

        Args:
            index: Index of the setup.
            arm: Name of the arm.
            labels: Keys of the segments whose moves count.
        """
        key = (index, arm, labels)
        if key not in self._tracks:
            self._tracks[key] = tool_path(self.context, *key)
        return self._tracks[key]

    def path_deviation(self, index: int, claim: MillsAlong) -> tuple[IntArray, PathDeviation] | None:
        """Compare a claimed path with its track.

        Args:
            index: Index of the setup.
            claim: Claimed path.

        Returns:
            Indices of the compared samples and the deviation, None if the track has no samples.
        """
        key = (index, id(claim))  # ids stay unique because the claims outlive this cache
        track = self.track(index, claim.arm, (claim.segment.key,))
        if key not in self._followed and len(track.rows):
            rows = rows_to_check(track.tip, track.axis, claim.tolerance)
            self._followed[key] = rows, match_path(claim, track.tip, track.axis, rows)
        return self._followed.get(key)

    def spaced_samples(
        self, index: int, arm: str, labels: tuple[str, ...], step: float, tolerance: float
    ) -> PathPositions:
        """Return samples along :meth:`track` at a given distance.

        They are those of :meth:`planner.proof.replay.tool_track.ReplayedToolPath.spaced`, and are cached,
        because several faces are compared with them.

        Args:
            index: Index of the setup.
            arm: Name of the arm.
            labels: Keys of the segments.
            step: Distance of the samples [m].
            tolerance: Tolerance [m]. Samples are added at bends until straight lines between them deviate by
                at most ``BEND_FRACTION`` of it.
        """
        key = (index, arm, labels, step, tolerance)
        if key not in self._spaced:
            self._spaced[key] = self.track(index, arm, labels).spaced(step, BEND_FRACTION * tolerance)
        return self._spaced[key]

    def samples_in_block(self, index: int, arm: str, cutter: Cutter) -> tuple[IntArray, IntArray, FloatArray]:
        """Return the samples, and instants between samples, at which the cutter is in the block.

        Args:
            index: Index of the setup.
            arm: Name of the arm.
            cutter: Its cutter.

        Returns:
            Index (M,) of each sample, or of the last sample before an instant, current moves (M,), and times
            (M,) [s].
        """
        queries, stock = self.context.motion.merged_samples, self.context.stock_at(index)
        rows = np.flatnonzero(with_start_stations(self.context.sample_setup[queries.sample] == index))
        is_inside = np.zeros(len(rows), dtype=bool)
        for part, poses in tcp_in_stock(self.context, index, arm, rows):
            tip, axis = poses[:, :3, 3], -poses[:, :3, 2]
            is_inside[part] = in_block(tip, axis, cutter.overhang, cutter.radius, stock)
        rows = rows[is_inside]
        return queries.sample[rows], queries.node[rows], queries.time[rows]


def _milling(context: Context) -> MillingMotion:
    return MillingMotion(context, context.motion_executor)


MILLING: Final[Fact[Context, MillingMotion]] = Fact("milling", _milling)
"""Milling of a proof."""


MAX_QUERY_DISTANCE_M = 3e-3
"""Distance from the tool [m] above which distances are not computed. Farther points get this distance."""


@dataclasses.dataclass(frozen=True)
class ToolSolid:
    """One piece of a tool: a cylinder with a rounded front edge.

    Attributes:
        name: Name in messages.
        start: Distance of the front from the tip [m].
        end: Distance of the rear from the tip [m].
        radius: Radius [m].
        corner: Radius of the front edge [m].
    """

    name: str
    start: float
    end: float
    radius: float
    corner: float = 0.0


def solids(cutter: Cutter) -> tuple[ToolSolid, ...]:
    """Return the pieces of a tool from the tip on: cutting part, shank, holder and spindle."""
    out = [ToolSolid("cutter", 0.0, cutter.flute, cutter.radius, cutter.corner)]
    if cutter.overhang > cutter.flute:
        out.append(ToolSolid("shank", cutter.flute, cutter.overhang, cutter.shank))
    count = len(cutter.holder_outline) // 2
    for k in range(count):
        a, b = cutter.holder_outline[2 * k], cutter.holder_outline[2 * k + 1]
        name = "spindle" if k == count - 1 else "holder"
        out.append(ToolSolid(name, float(a[0]), float(b[0]), float(a[1])))
    return tuple(out)


def signed_distance(solid: ToolSolid, axial: FloatArray, radial_distance: FloatArray) -> FloatArray:
    """Return the signed distance [m] of points from a solid, negative inside.

    It is the distance in the half section of the solid: from a rectangle, or from the arc at its rounded
    corner.

    Args:
        solid: Piece of a tool.
        axial: Coordinate of the points along the axis, from the tip [m].
        radial_distance: Distance of the points from the axis [m], of the same shape.
    """
    radial_excess = radial_distance - solid.radius
    axial_excess = np.maximum(solid.start - axial, axial - solid.end)
    out = np.maximum(radial_excess, axial_excess)
    edge = np.nonzero((radial_excess > 0.0) & (axial_excess > 0.0))
    out[edge] = np.hypot(radial_excess[edge], axial_excess[edge])
    if solid.corner > 0.0:
        axial_gap, radial_gap = solid.start + solid.corner - axial, radial_excess + solid.corner
        arc = np.nonzero((axial_gap > 0.0) & (radial_gap > 0.0))
        out[arc] = np.hypot(axial_gap[arc], radial_gap[arc]) - solid.corner
    return np.asarray(out)


def may_touch(vertices: FloatArray, tip: FloatArray, axis: FloatArray, solid: ToolSolid) -> bool:
    """Return whether a solid may come within ``MAX_QUERY_DISTANCE_M`` of a face, by bounding boxes.

    Args:
        vertices: Vertices of the face (V, 3) [m].
        tip: Tips of the track (M, 3) [m].
        axis: Axes of the track (M, 3).
        solid: Piece of a tool.
    """
    ends = np.concatenate([tip + solid.start * axis, tip + solid.end * axis])
    margin = solid.radius + MAX_QUERY_DISTANCE_M
    is_separate = (ends.min(axis=0) - margin > vertices.max(axis=0)) | (
        ends.max(axis=0) + margin < vertices.min(axis=0)
    )
    return not bool(is_separate.any())


def track_distance(
    points: FloatArray, tip: FloatArray, axis: FloatArray, solid: ToolSolid, exact_below: float = np.inf
) -> tuple[FloatArray, IntArray]:
    """Compute the distance of points from a solid along a track.

    Args:
        points: Points (P, 3) [m].
        tip: Tips of the track (M, 3) [m].
        axis: Axes of the track (M, 3).
        solid: Piece of a tool.
        exact_below: Only distances below this [m] and the smallest one are exact; others may be reported too
            large.

    Returns:
        Smallest distances (P,) [m], negative inside and at most ``MAX_QUERY_DISTANCE_M``, and the index (P,)
        of the sample with the smallest distance.
    """

    def distance(axial: FloatArray, radial_distance: FloatArray) -> FloatArray:
        return signed_distance(solid, axial, radial_distance)

    body = RoundBody(solid.start, solid.end, solid.radius, distance, solid.corner == 0.0)
    return least_distances(points, SweptBody(tip, axis, body), MAX_QUERY_DISTANCE_M, exact_below)


SLICE_LENGTH_M = 5e-3
"""Length [m] of slices of a tool at its edges. Gouges deeper than half of it are found without slices,
too.
"""
EDGE_SPACING_FACTOR = 2.0
"""Distance of samples and face points near sharp edges, as a factor of the tolerance.

The groove of an edge at 45 degrees that penetrates by the tolerance is twice as wide as deep. Steps between
two samples of such an edge are half as deep as the distance between the samples.
"""
MIN_STEP_M = 0.1e-3
"""Minimum distance of samples along the track [m]."""
MIN_SPACING_M = 0.4e-3
"""Minimum distance of face points [m]."""
MAX_FACE_POINTS = 4_000_000
"""Maximum number of face points near one piece of a tool."""


def edge_step(tolerance: float) -> float:
    """Return the distance between samples [m] at which edges are checked.

    Args:
        tolerance: Tolerance [m].
    """
    return max(EDGE_SPACING_FACTOR * tolerance, MIN_STEP_M)


def edge_slices(pieces: tuple[ToolSolid, ...]) -> tuple[ToolSolid, ...]:
    """Return slices of a tool's pieces at their sharp edges.

    A piece has a sharp front edge if it is wider than the previous piece and not rounded, and a sharp rear
    edge if it is wider than the next piece.
    """
    out: list[ToolSolid] = []
    for k, piece in enumerate(pieces):
        front_radius = pieces[k - 1].radius if k else 0.0
        rear_radius = pieces[k + 1].radius if k + 1 < len(pieces) else 0.0
        if piece.corner == 0.0 and piece.radius > front_radius:
            out.append(dataclasses.replace(piece, end=min(piece.end, piece.start + SLICE_LENGTH_M)))
        if piece.radius > rear_radius:
            out.append(
                dataclasses.replace(piece, start=max(piece.start, piece.end - SLICE_LENGTH_M), corner=0.0)
            )
    return tuple(out)


def edge_spacing(tolerance: float) -> float:
    """Return the distance [m] between face points near an edge: the width of its groove at the tolerance.

    Args:
        tolerance: Tolerance [m].
    """
    return max(EDGE_SPACING_FACTOR * tolerance, MIN_SPACING_M)


def round_spacing(radius: float, tolerance: float) -> float:
    """Return the distance [m] between face points near a round body.

    Between points at the distance s a body of radius r is deeper in the face by at most s^2 / (6 r) than at
    them. This is half of the tolerance.

    Args:
        radius: Radius of the body [m].
        tolerance: Tolerance [m].
    """
    return max(float(np.sqrt(3.0 * radius * tolerance)), MIN_SPACING_M)


def near_face_points(
    corners: FloatArray, solid: ToolSolid, tip: FloatArray, axis: FloatArray, size: float
) -> tuple[FloatArray, int]:
    """Return points of triangles near a solid along its path.

    Args:
        corners: Triangles (T, 3, 3) [m].
        solid: Piece of a tool.
        tip: Tips (M, 3) [m].
        axis: Axes (M, 3).
        size: Distance of the points [m].

    Returns:
        Points (P, 3) [m], and the required number of points. If it is above ``MAX_FACE_POINTS``, no points
        are returned.
    """
    body = RoundBody(solid.start, solid.end, solid.radius, functools.partial(signed_distance, solid))
    swept = SweptBody(tip, axis, body)
    points, _, count = points_near(corners, swept, MAX_QUERY_DISTANCE_M, size, MAX_FACE_POINTS)
    return points, count


@dataclasses.dataclass(frozen=True)
class GougeQuery:
    """A face that is compared with one solid of a tool along its path.

    Attributes:
        vertices: Vertices of the face (V, 3) [m].
        faces: Triangles (T, 3).
        solid: Piece of a tool.
        sharp: Whether the solid is a slice at a sharp edge.
        is_near: Whether the solid comes near the face at all.
        tip: Tips (M, 3) [m].
        axis: Axes (M, 3).
        tolerance: Tolerance [m], from which the distance of face points follows.
        allowed: Allowed penetration [m].
    """

    vertices: FloatArray
    faces: IntArray
    solid: ToolSolid
    sharp: bool
    is_near: bool
    tip: FloatArray
    axis: FloatArray
    tolerance: float
    allowed: float

    @property
    def spacing(self) -> float:
        """Distance between face points [m]."""
        return (
            edge_spacing(self.tolerance) if self.sharp else round_spacing(self.solid.radius, self.tolerance)
        )

    def evaluate(self) -> "GougeResult | int":
        """Return the face points inside the solid, or the required number of points if there are too many.

        Vertices of the face are also compared, except with slices at sharp edges.
        """
        points = self.vertices[:1]
        if self.is_near:
            corners = self.vertices[self.faces]
            near_points, count = near_face_points(corners, self.solid, self.tip, self.axis, self.spacing)
            if count > MAX_FACE_POINTS:
                return count
            points = np.concatenate([near_points, points if self.sharp else self.vertices])
        distances, samples = track_distance(points, self.tip, self.axis, self.solid, -self.allowed)
        k = int(distances.argmin())
        too_deep = np.flatnonzero(distances < -self.allowed)
        too_deep = too_deep[np.unique(samples[too_deep], return_index=True)[1]]  # one point for each sample
        return GougeResult(
            float(distances[k]), int(samples[k]), points[too_deep], distances[too_deep], samples[too_deep]
        )


@dataclasses.dataclass(frozen=True)
class GougeResult:
    """Face points inside a solid.

    Attributes:
        min_distance: Smallest distance of face points from the solid [m], negative inside.
        min_sample: Index of the sample at which it occurs.
        points: Points that are deeper inside than allowed (K, 3) [m], one for each sample.
        distances: Distances of these points (K,) [m].
        samples: Indices of their samples (K,).
    """

    min_distance: float
    min_sample: int
    points: FloatArray
    distances: FloatArray
    samples: IntArray


def evaluate_queries(queries: Sequence[GougeQuery]) -> Iterator[GougeResult | int]:
    """Yield the result of each query, as :meth:`GougeQuery.evaluate`."""
    for query in queries:
        yield query.evaluate()
