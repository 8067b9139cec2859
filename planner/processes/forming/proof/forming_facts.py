"""Facts that the rules on forming share: claims by segment, tracks and faces, each calculated once.

A track has the positions of a forming tool while it forms: its centres and axes in the sheet's frame, and the
same path as straight pieces from which it deviates by at most a stated bound.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Final

import numpy as np

from planner.claims.claim import Claim
from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.processes.forming.claims import FormsByTable, FormsPart, FormsSheet, SheetState, ToolGap
from planner.processes.forming.proof.compensation import (
    CompensatedSegment,
    CompensationClaim,
    compensated_segments,
    compensation_claims,
)
from planner.processes.forming.proof.face import NearestPoints, ProofFace, remaining_face
from planner.processes.forming.proof.formed_shapes import FormedFeature, PartShapes, ordered_passes
from planner.processes.forming.proof.level import SingleLevel, current_claims, single_levels
from planner.processes.forming.proof.tracks import ToolTrack, TrackPieces, make_track, straight_pieces
from planner.proof.context import Context
from planner.proof.facts import Fact

TRACK_CHORD_FRACTION = 0.1
"""Maximum deviation of the straight pieces of a track from it, as a fraction of the tolerance."""


class BallContacts:
    """The forming ball, that of a track's first arm, and the points of a face nearest to its centre.

    Results are cached by row, so that each row is evaluated once for all claims.
    """

    def __init__(self, track: ToolTrack, face: ProofFace) -> None:
        self.track, self.face = track, face
        self._rows = np.zeros(0, dtype=np.int64)
        self._nearest = face.nearest(np.zeros((0, 3)), TOUCH_TOLERANCE_M)

    def nearest_at(self, rows: IntArray) -> NearestPoints:
        """Return the nearest points at rows of the track; those within `TOUCH_TOLERANCE_M` are equally near.

        Args:
            rows: Rows (K,) of the track, ascending.
        """
        new_rows = np.setdiff1d(rows, self._rows)
        if len(new_rows):
            new_nearest = self.face.nearest(self.track.centre[new_rows, 0], TOUCH_TOLERANCE_M)
            if len(self._rows):
                cached_rows = np.concatenate([self._rows, new_rows])
                order = np.argsort(cached_rows)
                self._rows = cached_rows[order]
                self._nearest = self._nearest.concatenate(new_nearest).subset(order)
            else:
                self._rows, self._nearest = new_rows, new_nearest
        if np.array_equal(rows, self._rows):
            return self._nearest
        return self._nearest.subset(np.searchsorted(self._rows, rows))


@dataclasses.dataclass(frozen=True)
class FormedPass:
    """The face of a pass and the path of its tools.

    Attributes:
        claim: Claim on the pass.
        setup: Index of the setup.
        track: Track of the tools.
        pieces: Straight pieces of the track.
        knots: Rows (K + 1,) of the track at the ends of its pieces.
        face: Face.
        balls: Points of the face nearest to the forming ball.
        pending_face: Pending result of :func:`remaining_faces`, or None if it was not submitted.
        level: The single level that is formed, or None.
    """

    claim: FormsSheet
    setup: int
    track: ToolTrack
    pieces: TrackPieces
    knots: IntArray
    face: ProofFace
    balls: BallContacts
    pending_face: Iterator[ProofFace | None] | None = None
    level: SingleLevel | None = None

    @property
    def formed_depth(self) -> float:
        """Depth [m] below the surrounding flat to which the face is formed already."""
        return 0.0 if self.level is None else self.level.depths[0]

    @property
    def nearest(self) -> NearestPoints:
        """Points of the face nearest to the forming ball at the knots.

        `BallContacts` caches them. They are not cached here as well, because long passes have many.
        """
        return self.balls.nearest_at(self.knots)

    @cached_property
    def remaining_face(self) -> ProofFace:
        """The face with fillets of the ball's radius where the ball does not reach."""
        if self.pending_face is not None:
            return next(self.pending_face) or self.face
        return remaining_face(self.face, self.claim.radius, self.claim.side, self.claim.start)

    @cached_property
    def is_touching(self) -> BoolArray:
        """Whether (K + 1,) the ball touches the face at each knot.

        It does if its distance is at most the scallop, which the steps of the path leave, plus the tolerance.
        """
        nearest_points = self.nearest
        max_distance = self.claim.radius + self.claim.scallop[self.face.rows[nearest_points.triangle]]
        out = np.zeros(len(self.knots), dtype=np.bool_)
        np.logical_or.at(
            out,
            nearest_points.row,
            nearest_points.distance[nearest_points.row] <= max_distance + self.claim.tolerance,
        )
        return out


@dataclasses.dataclass(frozen=True)
class GapTrack:
    """Two tools in one segment and the gap between them.

    Attributes:
        claim: Claim on the gap.
        track: Track of the tools.
        pieces: Straight pieces of the segment itself, without approach and retreat.
        knots: Rows (K,) of the track at the ends of the pieces, and where two controllers meet.
        face: Face.
        balls: Points of the face nearest to the forming ball.
        low: Minimum required gap (K,) [m].
        high: Maximum required gap (K,) [m].
    """

    claim: ToolGap
    track: ToolTrack
    pieces: TrackPieces
    knots: IntArray
    face: ProofFace
    balls: BallContacts
    low: FloatArray
    high: FloatArray

    @property
    def nearest(self) -> NearestPoints:
        """Points of the face nearest to the forming ball at the knots, which `BallContacts` caches."""
        return self.balls.nearest_at(self.knots)

    @cached_property
    def actual_gap(self) -> FloatArray:
        """The gap (K,) [m] at the knots: the distance of the balls minus their radii."""
        centre = self.track.centre[self.knots]
        return np.asarray(np.linalg.norm(centre[:, 0] - centre[:, 1], axis=1) - sum(self.claim.radii))


def _meeting_rows(context: Context, tool_track: ToolTrack) -> IntArray:
    """Return the rows of a track at which two controllers meet while it forms.

    They are at the same target at the same instant then. Between these rows one arm may be ahead of the
    other.
    """
    out = [np.zeros(0, dtype=np.int64)]
    for number, stage in enumerate(context.job.stages):
        nodes = np.flatnonzero(context.motion.node_stage == number)
        out.append(context.motion.node_sample[nodes[[end for end in stage.ends if end < len(nodes)]]])
    rows = np.flatnonzero(np.isin(tool_track.rows, np.concatenate(out)))
    return rows[tool_track.is_forming[rows]]


TOUCH_TOLERANCE_M = 5e-6
"""Points of a face that are at most this much [m] farther from the ball than the nearest one are touched as
well, because facets are chords.
"""


def remaining_faces(claim: FormsSheet) -> Iterator[ProofFace | None]:
    """Yield the face of a pass as its ball leaves it, or None if that is the claimed face."""
    face = ProofFace(claim.vertices, claim.faces, claim.radius)
    remaining = remaining_face(face, claim.radius, claim.side, claim.start)
    yield None if remaining is face else remaining


PendingFaces = Mapping[int, Iterator[ProofFace | None]]
"""Pending results of :func:`remaining_faces`, by the ``id`` of the claim."""


def _submit_remaining_faces(context: Context) -> PendingFaces:
    """Submit the calculation of the remaining face of each pass whose other side a second tool supports.

    These faces follow from claims alone, so another process calculates them while program texts are read.
    """
    claims = [
        claim for setup in context.setup_claims for group in setup.groups for claim in current_claims(group)
    ]
    supported = {c.segment.key for c in claims if isinstance(c, SheetState) and len(c.arms) > 1}
    formed = [c for c in claims if isinstance(c, FormsSheet) and c.segment.key in supported]
    if not context.executor.parallel:
        return {}
    return {id(claim): context.executor.submit(remaining_faces, claim) for claim in formed}


REMAINING_FACES: Final[Fact[Context, PendingFaces]] = Fact(
    "left faces", _submit_remaining_faces, persistent=True
)
"""Pending results of :func:`remaining_faces`."""


class FormingFacts:
    """What rules on forming share in one proof. Faces are kept in the context's cache for later proofs.

    Attributes:
        by_setup: All claims on the programs, each with the index of its setup.
    """

    def __init__(self, context: Context) -> None:
        self.context, self.executor = context, context.executor
        self._pending_faces = context.get(REMAINING_FACES)
        self._tracks: dict[tuple[str, int, tuple[str, ...]], ToolTrack] = {}
        self._faces: list[tuple[float, ProofFace]] = context.cache.setdefault("faces", [])
        self._balls: dict[tuple[int, int], BallContacts] = {}
        self.by_setup: tuple[tuple[int, Claim], ...] = tuple(
            (index, claim)
            for index, setup in enumerate(context.setup_claims)
            for group in setup.groups
            for claim in current_claims(group)
        )

    @cached_property
    def levels(self) -> tuple[SingleLevel, ...]:
        """All single levels that operations form, with their files."""
        groups = [(k, group) for k, setup in enumerate(self.context.setup_claims) for group in setup.groups]
        return single_levels(self.context.problem, groups)

    def level(self, segment: Segment, index: int) -> SingleLevel | None:
        """Return the single level that is formed of a segment in the setup ``index``, or None.

        A level whose operation does not state it is ignored here; the rule on levels reports it.
        """
        candidates = (
            level for level in self.levels if level.claim.segment == segment and level.index == index
        )
        return next(
            (level for level in candidates if getattr(level.operation, "level", None) is not None), None
        )

    @cached_property
    def parts(self) -> tuple[tuple[PartShapes | None, tuple[Claim, ...]], ...]:
        """For each forming operation the shapes of its part and passes, and all its claims.

        The shapes are None if no claim states the part. An operation that forms only some features of a part
        starts from the features of previous operations.
        """
        out: list[tuple[PartShapes | None, tuple[Claim, ...]]] = []
        previous: tuple[FormedFeature, ...] = ()
        for setup in self.context.setup_claims:
            for group in setup.groups:
                part = next((claim for claim in group if isinstance(claim, FormsPart)), None)
                passes = ordered_passes(group)
                if part is None and not passes:
                    continue
                part_shapes = None
                if part is not None:
                    part_shapes = PartShapes(part, passes, () if part.features is None else previous)
                    previous = (*previous, *(feature for _, feature in part_shapes.own_features))
                out.append((part_shapes, group))
        return tuple(out)

    def later_displacement(self, group: Sequence[Claim], points: FloatArray) -> FloatArray:
        """Return how far (N,) [m] along z later operations move the sheet at points in plan (N, 2).

        Later are the operations after the one with this group of claims. During that operation the sheet is
        by this much away from the finished part.
        """
        order = [id(claims) for setup in self.context.setup_claims for claims in setup.groups]
        out = np.zeros(len(points))
        for part_shapes, other in self.parts:
            if part_shapes is not None and order.index(id(other)) > order.index(id(group)):
                for _, feature in part_shapes.own_features:
                    out += feature.final.displacement(points)
        return out

    @cached_property
    def formed(self) -> tuple[FormedPass, ...]:
        """All claimed passes. In their tracks the forming arm comes first and the others after it."""
        return tuple(
            self._make_formed_pass(claim, index)
            for index, claim in self.by_setup
            if isinstance(claim, FormsSheet)
        )

    @cached_property
    def gaps(self) -> tuple[GapTrack, ...]:
        """All claimed gaps. A gap has no knots if its arms never form the segment together."""
        return tuple(self._make_gap_track(c, index) for index, c in self.by_setup if isinstance(c, ToolGap))

    def pass_of_segment(self, segment: Segment) -> FormedPass | None:
        """Return the pass of a segment, or None if its tools follow a table instead of a face."""
        return next((formed for formed in self.formed if formed.claim.segment.key == segment.key), None)

    @cached_property
    def sheet_states(self) -> tuple[tuple[int, SheetState], ...]:
        """All claims on the state of the sheet that tools meet, each with the index of its setup."""
        return tuple((index, claim) for index, claim in self.by_setup if isinstance(claim, SheetState))

    @cached_property
    def gap_segments(self) -> frozenset[str]:
        """Segments in which two tools hold the sheet between them."""
        return frozenset(claim.segment.key for _, claim in self.by_setup if isinstance(claim, ToolGap))

    def allowed_standoff(self, formed: FormedPass) -> float | None:
        """Return the distance [m] that the ball of a pass may stay off the part where it does not fit.

        The result is None if the problem does not limit it, or if a later pass forms the feature further.
        """
        finals = [
            (part_shapes.part.unreached, claim)
            for part_shapes, _ in self.parts
            if part_shapes is not None
            for feature in part_shapes.features
            for claim in feature.final.claims
        ]
        return next((limit for limit, claim in finals if claim is formed.claim), None)

    def pass_steps(self, formed: FormedPass) -> tuple[float | None, float | None]:
        """Return the step-down and the scallop [m] of the operation of a pass; one of them is given.

        Both are None if no claim states the operation's part.
        """
        for part_shapes, group in self.parts:
            if part_shapes is not None and any(claim is formed.claim for claim in group):
                return part_shapes.part.steps
        return None, None

    @cached_property
    def labels(self) -> frozenset[str]:
        """Labels of all moves of claimed passes, with their approach and retreat."""
        segments = [
            claim.segment for _, claim in self.by_setup if isinstance(claim, FormsSheet | FormsByTable)
        ]
        return frozenset(part.key for segment in segments for part in segment.all_phases)

    @cached_property
    def compensations(self) -> tuple[CompensationClaim, ...]:
        """All claims of springback compensation, with their files."""
        return compensation_claims(self.context.problem, self.by_setup)

    @cached_property
    def _released(self) -> dict[tuple[str, int], CompensatedSegment]:
        """Compensations by segment key and setup, with which the shifts of tools are removed."""
        return compensated_segments(self.compensations, self.levels, self.by_setup)

    def get_track(self, segment: Segment, index: int, arms: tuple[str, ...]) -> ToolTrack:
        """Return the track of a segment in the setup ``index`` without springback shifts, calculated once."""
        key = (segment.key, index, arms)
        if key not in self._tracks:
            compensation = self._released.get((segment.key, index))
            self._tracks[key] = make_track(self.context, segment, index, arms, compensation)
        return self._tracks[key]

    def _get_face(self, vertices: FloatArray, faces: IntArray, scale: float) -> ProofFace:
        """Return a face, calculated once for claims on the same triangles, however they number vertices."""
        corners = vertices[faces]
        for cached_scale, face in self._faces:
            if cached_scale == scale and np.array_equal(face.given, corners):
                return face
        self._faces.append((scale, ProofFace(vertices, faces, scale)))
        return self._faces[-1][1]

    def _get_balls(self, tool_track: ToolTrack, face: ProofFace) -> BallContacts:
        """Return the contacts of the forming ball on a track, shared by claims with the same track and face.

        The ids are unique keys, because tracks and faces live as long as this object.
        """
        key = (id(tool_track), id(face))
        if key not in self._balls:
            self._balls[key] = BallContacts(tool_track, face)
        return self._balls[key]

    def _make_formed_pass(self, claim: FormsSheet, index: int) -> FormedPass:
        """Collect the track, the face and their contacts for a claim on a pass in the setup ``index``."""
        arms = [arm.name for arm in self.context.setups[index].cell.arms if arm.name != claim.arm]
        arms = [arm for arm in arms if arm in self.context.motion.tcp]
        tool_track = self.get_track(claim.segment, index, (claim.arm, *arms))
        pieces = straight_pieces(tool_track, TRACK_CHORD_FRACTION * claim.tolerance)
        knots = np.unique(np.concatenate([pieces.first, pieces.last]))
        face = self._get_face(claim.vertices, claim.faces, claim.radius)
        pending = self._pending_faces.get(id(claim))
        level = self.level(claim.segment, index)
        return FormedPass(
            claim, index, tool_track, pieces, knots, face, self._get_balls(tool_track, face), pending, level
        )

    def _make_gap_track(self, claim: ToolGap, index: int) -> GapTrack:
        """Collect the track and the permitted gaps for a claim on two tools in the setup ``index``."""
        tool_track = self.get_track(claim.segment, index, claim.arms)
        pieces = straight_pieces(tool_track, TRACK_CHORD_FRACTION * claim.tolerance)
        is_forming = tool_track.is_forming[pieces.first]
        pieces = TrackPieces(
            pieces.first[is_forming],
            pieces.last[is_forming],
            pieces.deviation[is_forming],
            pieces.distance_error[is_forming],
        )
        knots = np.unique(
            np.concatenate([pieces.first, pieces.last, _meeting_rows(self.context, tool_track)])
        )
        face = self._get_face(claim.vertices, claim.faces, claim.radii[0])
        balls = self._get_balls(tool_track, face)
        gap_range = face.value_range(balls.nearest_at(knots), claim.gap[claim.faces])
        return GapTrack(claim, tool_track, pieces, knots, face, balls, *gap_range)


FORMING: Final[Fact[Context, FormingFacts]] = Fact("forming", FormingFacts)
"""The shared data of the rules on forming in one proof."""
