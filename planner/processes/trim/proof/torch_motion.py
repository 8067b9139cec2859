"""Motion of a torch, mill or knife while it trims: its path, its signal, and its distance from the sheet."""

import dataclasses
import itertools
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.geometry.swept_body import RoundBody, SweptBody, least_distances, points_near
from planner.issues import Issue
from planner.processes.forming.proof.forming_facts import FORMING
from planner.processes.trim.claims import TrimsSheet, slot_names
from planner.processes.trim.proof.outlines import TRIM, FacePoints, OutlineCurve, SheetSide
from planner.proof.context import Context
from planner.proof.facts import Fact
from planner.proof.part_files import UnreadError
from planner.proof.replay.tool_track import ReplayedToolPath, tool_path
from planner.tooling import Torch

MAX_QUERY_DISTANCE_M = 20e-3
"""Distances of a tool from the sheet are calculated only up to this one [m]."""
FACE_SPACING_M = 0.8e-3
"""Maximum distance of face points that are compared with a tool [m]."""
SAMPLE_STEP_M = 0.2e-3
"""Maximum distance of samples of a tool's path [m]."""
SAMPLING_ERROR_M = 0.02e-3
"""Deviation that may be hidden between samples of paths and curves [m]."""
BEND_FRACTION = 0.05
"""Fraction of the tolerance by which straight lines between samples may deviate from the path."""
MAX_FACE_POINTS = 1_000_000
"""Maximum number of face points."""


@dataclasses.dataclass(frozen=True)
class OnIntervals:
    """Intervals in which a signal is on.

    Attributes:
        start: Starts (B,) [s].
        end: Ends (B,) [s].
    """

    start: FloatArray
    end: FloatArray

    @staticmethod
    def from_motion(context: Context, claim: TrimsSheet) -> "OnIntervals":
        """Return the intervals in which the programs have the signal of a claim on.

        Args:
            context: Context of the proof.
            claim: Claim on the sheet.
        """
        starts: list[float] = []
        ends: list[float] = []
        for time, value in context.motion.signal_changes(
            claim.signal, context.controller_task_names((claim.arm,))
        ):
            if value and len(starts) == len(ends):
                starts.append(time)
            elif not value and len(starts) > len(ends):
                ends.append(time)
        if len(starts) > len(ends):
            ends.append(float("inf"))
        return OnIntervals(np.array(starts), np.array(ends))

    def contains(self, time: FloatArray) -> BoolArray:
        """Return whether (T,) the signal is on at times (T,) [s], ends of intervals included."""
        indices = np.searchsorted(self.start, time, side="right") - 1
        inside = indices >= 0
        out = np.zeros(len(time), dtype=bool)
        out[inside] = time[inside] <= self.end[indices[inside]]
        return out


INTERSECTION_ITERATIONS = 8
"""Number of fixed-point iterations for the intersection of an axis with a face."""


@dataclasses.dataclass(frozen=True)
class SlotPath:
    """Samples of the tool in one slot, at most ``SAMPLE_STEP_M`` apart.

    Attributes:
        tip: Tips (N, 3) [m].
        axis: Directions from the TCP into the tool (N, 3).
        feet: Points on the face that the tool cuts.
        rows: Indices of the samples of the motion (N,).
        curve_distance: Distances of these points from the curve (N,) [m], negative on the part.
        at: Lengths along the curve (N,) [m] of the points of the curve nearest to them.
        depth: Depth of the tip of a mill or knife behind the face, along its axis (N,) [m]; zero for a torch.
    """

    tip: FloatArray
    axis: FloatArray
    feet: FacePoints
    rows: IntArray
    curve_distance: FloatArray
    at: FloatArray
    depth: FloatArray


def face_distance(sheet: SheetSide, tip: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the distance (N,) [m] along a tool's axis from the tip to the face, negative against the axis.

    Args:
        sheet: Face of the sheet.
        tip: Tips (N, 3) [m].
        axis: Unit directions from the TCP into the tool (N, 3).
    """
    out = np.zeros(len(tip))
    for _ in range(INTERSECTION_ITERATIONS):
        points = tip + out[:, None] * axis
        point, normal = sheet.at(points[:, :2])
        slope = (axis * normal).sum(axis=1)
        slope = np.where(np.abs(slope) < 0.1, np.copysign(0.1, slope), slope)
        out = out - ((points - point) * normal).sum(axis=1) / slope
    return out


class TrimmedSheet:
    """One claim on a trimmed sheet in the setup ``index``, with the motion of its tool.

    ``remaining_forming`` returns how far (N,) [m] later operations move the sheet along z at points in plan
    (N, 2).

    Attributes:
        sheet: Face on the side of the tool.
        curves: Outlines on the face.
        track: Track of the tool in all segments.
        cache: Results that other modules derive from it, by key.
        on_intervals: Intervals in which the signal of the tool is on.

    Raises:
        UnreadError: If part or curves cannot be read.
    """

    def __init__(
        self,
        context: Context,
        index: int,
        claim: TrimsSheet,
        remaining_forming: Callable[[FloatArray], FloatArray],
    ) -> None:
        self.context, self.index, self.claim = context, index, claim
        part = context.problem.source.get("part")
        self.sheet = SheetSide(claim, part, remaining_forming)
        self._other = partial(
            SheetSide, dataclasses.replace(claim, side=-claim.side), part, remaining_forming
        )
        self.curves = tuple(OutlineCurve(outline, self.sheet) for outline in claim.outlines)
        self._tracks: dict[tuple[str, ...], ReplayedToolPath] = {}
        labels = tuple(sorted(set(context.motion.node_label.tolist())))
        self.track = self._track(labels)
        self._paths: dict[str, SlotPath | None] = {}
        self.cache: dict[str, Any] = {}
        self.on_intervals = OnIntervals.from_motion(context, claim)

    @property
    def edge_tolerance(self) -> float:
        """Maximum distance [m] of a slot's edge from its outline.

        Where the edge is nearer, the tool counts as cutting the outline, and has to meet all requirements
        there.
        """
        return self.claim.tolerance + self.sheet.tolerance + SAMPLING_ERROR_M

    @cached_property
    def other_side(self) -> SheetSide:
        """The face of the sheet on the other side, which is read only if it is needed."""
        return self._other()

    def project(self, tip: FloatArray, axis: FloatArray) -> tuple[FacePoints, FloatArray]:
        """Return the points of the face that a tool cuts, and the depth (N,) [m] of its tip behind the face.

        For a torch the point is the foot of the tip and the depth is 0, for other tools it is the
        intersection of the axis with the face.

        Args:
            tip: Tips (N, 3) [m].
            axis: Directions from the TCP into the tool (N, 3).
        """
        if self.claim.through_tool is None:
            return self.sheet.project(tip), np.zeros(len(tip))
        depth = face_distance(self.sheet, tip, axis)
        return self.sheet.project(tip + depth[:, None] * axis), depth

    @cached_property
    def slots(self) -> dict[str, OutlineCurve]:
        """The curve that each slot cuts, by the key of its segment.

        A knife may be lifted any number of times, so of its possible slots only those are included that occur
        in the motion.
        """
        curve_by_key = {
            Segment(TRIM, name).key: curve
            for curve in self.curves
            for name in slot_names(self.claim, curve.outline)
        }
        if self.claim.knife is None:
            return curve_by_key
        occurring = set(self.context.motion.node_label.tolist())
        return {key: curve for key, curve in curve_by_key.items() if key in occurring}

    def _track(self, labels: tuple[str, ...]) -> ReplayedToolPath:
        """Return the track of the tool in segments with some labels, calculated once."""
        if labels not in self._tracks:
            self._tracks[labels] = tool_path(self.context, self.index, self.claim.arm, labels)
        return self._tracks[labels]

    def slot_track(self, key: str) -> ReplayedToolPath:
        """Return the track of the tool in one slot, by the key of its segment."""
        return self._track((key,))

    def slot_path(self, key: str) -> SlotPath | None:
        """Return the path of the tool in one slot, None if it does not move there."""
        if key not in self._paths:
            track, curve = self.slot_track(key), self.slots[key]
            self._paths[key] = None
            if len(track.rows) > 1:
                tip, axis, rows = track.spaced(SAMPLE_STEP_M, BEND_FRACTION * self.claim.tolerance)
                order = np.argsort(rows, kind="stable")
                tip, axis, rows = tip[order], axis[order], rows[order]
                feet, depth = self.project(tip, axis)
                distances, at = curve.distance(feet.foot)
                distances = np.where(curve.in_waste(feet.foot), distances, -distances)
                self._paths[key] = SlotPath(tip, axis, feet, rows, distances, at, depth)
        return self._paths[key]

    def slot_paths(self, curve: OutlineCurve) -> dict[str, SlotPath | None]:
        """Return :meth:`slot_path` of each slot of a curve, by its key."""
        return {key: self.slot_path(key) for key, slot_curve in self.slots.items() if slot_curve is curve}


class Trimming:
    """All claims on trimmed sheets of a proof.

    Attributes:
        sheets: The claims whose part and curves can be read.
        issues: Issues of the other claims.
    """

    def __init__(self, context: Context) -> None:
        self.context, forming = context, context.get(FORMING)
        sheets, self.issues = list[TrimmedSheet](), list[Issue]()
        for index, setup in enumerate(context.setup_claims):
            for group in setup.groups:
                for claim in group:
                    if not isinstance(claim, TrimsSheet):
                        continue
                    try:
                        remaining_forming = partial(forming.later_displacement, group)
                        sheets.append(TrimmedSheet(context, index, claim, remaining_forming))
                    except (UnreadError, OSError) as error:
                        message = f"part or curves cannot be read a second time: {error}"
                        self.issues.append(Issue("verify.trim_cut", message, field="operations.outlines"))
        self.sheets = tuple(sheets)


TRIMMING: Final[Fact[Context, Trimming]] = Fact("trimming", Trimming)
"""The trimmed sheets of a proof, which its rules share."""


REST_TOLERANCE_M = 0.05e-3
"""A torch that moves by no more than this [m] is at rest."""


def start_row(track: ReplayedToolPath) -> int:
    """Return the index of the last sample before a tool leaves the start of its track.

    Up to this sample it rests, as a torch does while it pierces. The index is 0 if the tool moves at once,
    and the last one if it never moves.
    """
    moved = np.linalg.norm(track.tip - track.tip[:1], axis=1) > REST_TOLERANCE_M
    return max(int(np.argmax(moved)) - 1, 0) if moved.any() else len(moved) - 1


FIRST_BATCH = 256
"""Number of samples in the first batch of a search. Each further batch is four times as large."""


def longest_stay(track: ReplayedToolPath, distance: float) -> float:
    """Return the longest time [s] for which a tool stays within a distance of a position.

    It is compared with the time limit of the watchdog. The first interval starts when the tool starts to
    move. Each ends at the first sample that is farther than ``distance`` from its start, at which the next
    one starts.

    Args:
        track: Track of the tool.
        distance: Distance [m].
    """
    longest, last, start = 0.0, len(track.tip) - 1, start_row(track)
    while start < last:
        count, is_away = FIRST_BATCH, np.zeros(0, dtype=bool)
        while not is_away.any() and len(is_away) < last - start:
            offsets = track.tip[start + 1 : start + 1 + count] - track.tip[start]
            is_away = np.linalg.norm(offsets, axis=1) > distance
            count *= 4
        step = int(np.argmax(is_away)) + 1 if is_away.any() else len(is_away)
        longest = max(longest, float(track.time[start + step] - track.time[start]))
        start = start + step
    return longest


def torch_body(torch: Torch) -> RoundBody:
    """Return a torch as a body of revolution, from the TCP backwards: cone and body.

    Distances are those from its half section, a convex polygon: from its edges outside, from the nearest edge
    inside.
    """
    corners = np.array(
        [
            [torch.standoff, 0.0],
            [torch.standoff, torch.nozzle],
            [torch.standoff + torch.cone, torch.body],
            [torch.back, torch.body],
            [torch.back, 0.0],
        ]
    )

    def distance(axial: FloatArray, radial: FloatArray) -> FloatArray:
        shape, point = axial.shape, np.stack([axial.ravel(), radial.ravel()], axis=1)
        best, inside = np.full(len(point), np.inf), np.ones(len(point), dtype=bool)
        for a, b in itertools.pairwise(corners):
            edge, rest = b - a, point - a
            inside &= edge[0] * rest[:, 1] - edge[1] * rest[:, 0] <= 0.0
            fraction = np.clip(rest @ edge / max(float(edge @ edge), 1e-24), 0.0, 1.0)
            best = np.minimum(best, np.linalg.norm(rest - fraction[:, None] * edge, axis=1))
        return np.asarray(np.where(inside, -best, best).reshape(shape))

    return RoundBody(torch.standoff, torch.back, torch.body, distance)


def cylinder(low: float, high: float, radius: float) -> RoundBody:
    """Return a cylinder from ``low`` to ``high`` [m] behind the tip."""

    def distance(axial: FloatArray, radial: FloatArray) -> FloatArray:
        side, ends = radial - radius, np.maximum(low - axial, axial - high)
        outside = np.hypot(np.maximum(side, 0.0), np.maximum(ends, 0.0))
        return np.asarray(np.where(outside > 0.0, outside, np.maximum(side, ends)))

    return RoundBody(low, high, radius, distance)


def clear_bodies(claim: TrimsSheet) -> list[RoundBody]:
    """Return the bodies that keep clear of the sheet: torch; shank, holder, spindle of a mill; knife body."""
    if claim.torch is not None:
        return [torch_body(claim.torch)]
    if claim.knife is not None:
        return [cylinder(claim.knife.blade.length, claim.knife.back, claim.knife.body)]
    if claim.mill is None:
        return []
    cutter = claim.mill.cutter
    out = [cylinder(cutter.flute, cutter.overhang, cutter.shank)] if cutter.overhang > cutter.flute else []
    rings = cutter.holder_outline.tolist()
    return out + [cylinder(a[0], b[0], a[1]) for a, b in zip(rings[::2], rings[1::2], strict=True)]


def sheet_distance(work: TrimmedSheet, rows: IntArray) -> tuple[float, int]:
    """Return the smallest distance [m] of the tool from the sheet, and the row of the track there.

    The distance is calculated up to ``MAX_QUERY_DISTANCE_M``.

    Args:
        work: Claim with the motion.
        rows: Rows of the track at which the tool is compared.

    Raises:
        UnreadError: If the sheet has too many points to be compared.
    """
    distances = [_body_distance(work, rows, part) for part in clear_bodies(work.claim)]
    return min(distances, key=lambda result: result[0])


def _body_distance(work: TrimmedSheet, rows: IntArray, body: RoundBody) -> tuple[float, int]:
    """Return the smallest distance [m] of one body of the tool from the sheet, and the track's row there.

    The sheet is the mesh with the flat rectangles around it, out to the edges of the stock. The distance is
    calculated up to ``MAX_QUERY_DISTANCE_M``.
    """
    swept = SweptBody(work.track.tip[rows], work.track.axis[rows], body)
    corners = work.sheet.vertices[work.sheet.faces]
    low, high = corners.reshape(-1, 3)[:, :2].min(axis=0), corners.reshape(-1, 3)[:, :2].max(axis=0)
    size = 0.5 * np.asarray(work.context.stock_at(work.index).size)[:2]
    flat = []
    xs, ys = [min(-size[0], low[0]), max(size[0], high[0])], [min(-size[1], low[1]), max(size[1], high[1])]
    # rectangles left, right, below and above the bounds of the mesh
    for x0, y0, x1, y1 in (
        (xs[0], ys[0], low[0], ys[1]),
        (high[0], ys[0], xs[1], ys[1]),
        (low[0], ys[0], high[0], low[1]),
        (low[0], high[1], high[0], ys[1]),
    ):
        a, b, c, d = (
            np.array([x, y, work.sheet.height]) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
        )
        flat += [np.array([a, b, c]), np.array([a, c, d])]
    triangles = np.concatenate([corners, np.array(flat)])
    # face points farther away than the nearest vertex cannot be the nearest ones
    distances, where = least_distances(work.sheet.vertices, swept, MAX_QUERY_DISTANCE_M, -np.inf)
    k = int(np.argmin(distances))
    max_distance = max(float(distances[k]), 0.0) + SAMPLING_ERROR_M
    points, _, count = points_near(triangles, swept, max_distance, FACE_SPACING_M, MAX_FACE_POINTS)
    if count > MAX_FACE_POINTS:
        raise UnreadError(f"the sheet would have to be checked at {count} points, allowed {MAX_FACE_POINTS}")
    point_distances, point_where = least_distances(points, swept, max_distance, -np.inf)
    if len(point_distances) and float(point_distances.min()) < float(distances[k]):
        distances, where, k = point_distances, point_where, int(np.argmin(point_distances))
    return float(distances[k]), int(rows[where[k]])
