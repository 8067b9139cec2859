"""What the rules on forming share: claims by segment, tracks, faces, each worked out once.

A track is where a forming tool is while it forms: its centres and axes in the sheet's frame, and
the same way as few straight pieces from which it is off by no more than a stated bound.
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
from planner.processes.forming.proof.face import Face, Nearest, left_by
from planner.processes.forming.proof.level import OneLevel, now
from planner.processes.forming.proof.level import told as levels_told
from planner.processes.forming.proof.released import Released, Told, released, told
from planner.processes.forming.proof.shapes import Feature, PartShapes, in_order
from planner.processes.forming.proof.tracks import Pieces, Track, pieces, track
from planner.proof.context import Context
from planner.proof.facts import Fact

TRACK_CHORD_SHARE = 0.1
"""The straight pieces of a track are off it by this share of the tolerance at most."""


class Balls:
    """The forming ball at rows of a track: what of the face is nearest to it, each row asked once for all
    claims."""

    def __init__(self, track: Track, face: Face) -> None:
        self.track, self.face = track, face
        self._rows = np.zeros(0, dtype=np.int64)
        self._near = face.nearest(np.zeros((0, 3)), TOUCHED_WITHIN)

    def near(self, rows: IntArray) -> Nearest:
        """At ``rows`` (K,) of the track, ascending; ties within `TOUCHED_WITHIN`."""
        fresh = np.setdiff1d(rows, self._rows)
        if len(fresh):
            found = self.face.nearest(self.track.centre[fresh, 0], TOUCHED_WITHIN)
            if len(self._rows):
                known = np.concatenate([self._rows, fresh])
                order = np.argsort(known)
                self._rows, self._near = known[order], self._near.followed_by(found).at(order)
            else:
                self._rows, self._near = fresh, found
        if np.array_equal(rows, self._rows):
            return self._near
        return self._near.at(np.searchsorted(self._rows, rows))


@dataclasses.dataclass(frozen=True)
class Formed:
    """The face of a pass and the way of its tools; ``knots`` (K + 1,) rows of the track where its pieces
    meet, ``near`` what of the face is nearest to the forming ball there; ``left`` what :func:`left_of` says
    where that has been begun. ``level``: the one that is formed alone, if so."""

    claim: FormsSheet
    setup: int
    track: Track
    pieces: Pieces
    knots: IntArray
    face: Face
    balls: Balls
    left: Iterator[Face | None] | None = None
    level: OneLevel | None = None

    @property
    def begun(self) -> float:
        """How deep [m] below the flat around it the face is formed already."""
        return 0.0 if self.level is None else self.level.depths[0]

    @property
    def near(self) -> Nearest:
        """What of the face is nearest to the forming ball at the knots; ties within 5 um. Not kept twice, as
        long passes have many."""
        return self.balls.near(self.knots)

    @cached_property
    def remaining_face(self) -> Face:
        """The face as the ball leaves it where it reaches no nearer: with fillets of its own radius."""
        if self.left is not None:
            return next(self.left) or self.face
        return left_by(self.face, self.claim.radius, self.claim.side, self.claim.start)

    @cached_property
    def touches(self) -> BoolArray:
        """Knots (K + 1,) at which the ball is off the nearest place of the face by no more than the steps of
        the path leave there."""
        near = self.near
        reach = self.claim.radius + self.claim.scallop[self.face.rows[near.triangle]]
        out = np.zeros(len(self.knots), dtype=np.bool_)
        np.logical_or.at(out, near.row, near.apart[near.row] <= reach + self.claim.tolerance)
        return out


@dataclasses.dataclass(frozen=True)
class Opened:
    """Two tools in one segment and the gap between them: ``pieces`` those of the segment itself, ``knots``
    (K,) rows of the track where they meet.

    The wanted gap is between ``low`` and ``high`` (K,) [m].
    """

    claim: ToolGap
    track: Track
    pieces: Pieces
    knots: IntArray
    face: Face
    balls: Balls
    low: FloatArray
    high: FloatArray

    @property
    def near(self) -> Nearest:
        """What of the face is nearest to the forming ball at the knots; not kept twice."""
        return self.balls.near(self.knots)

    @cached_property
    def got(self) -> FloatArray:
        """The gap (K,) [m] at the knots: the distance of the balls less their radii."""
        centre = self.track.centre[self.knots]
        return np.asarray(np.linalg.norm(centre[:, 0] - centre[:, 1], axis=1) - sum(self.claim.radii))


def _meetings(context: Context, way: Track) -> IntArray:
    """Rows of a track, within what forms, at which two controllers meet: one arm is ahead from one of them to
    the next, wherever the straight pieces of the track end."""
    out = [np.zeros(0, dtype=np.int64)]
    for number, stage in enumerate(context.job.stages):
        nodes = np.flatnonzero(context.motion.node_stage == number)
        out.append(context.motion.node_sample[nodes[[end for end in stage.ends if end < len(nodes)]]])
    rows = np.flatnonzero(np.isin(way.rows, np.concatenate(out)))
    return rows[way.own[rows]]


TOUCHED_WITHIN = 5e-6
"""Places of a face that are so near to the nearest one [m] are touched as well: facets are chords."""


def left_of(claim: FormsSheet) -> Iterator[Face | None]:
    """The face of a pass as its ball leaves it, None where that is the face as it is claimed."""
    face = Face(claim.vertices, claim.faces, claim.radius)
    left = left_by(face, claim.radius, claim.side, claim.start)
    yield None if left is face else left


Left = Mapping[int, Iterator[Face | None]]
"""What has been begun of :func:`left_of`, by the ``id`` of the claim."""


def _begun_faces(context: Context) -> Left:
    """Begin what is left of faces on whose other side a tool supports the sheet.

    That follows from claims alone, so another process works on it while texts are read.
    """
    claims = [claim for setup in context.setup_claims for group in setup.groups for claim in now(group)]
    held = {c.segment.key for c in claims if isinstance(c, SheetState) and len(c.arms) > 1}
    formed = [c for c in claims if isinstance(c, FormsSheet) and c.segment.key in held]
    if not context.executor.parallel:
        return {}
    return {id(claim): context.executor.submit(left_of, claim) for claim in formed}


LEFT_FACES: Final[Fact[Context, Left]] = Fact("left faces", _begun_faces, lasting=True)
"""What has been begun of :func:`left_of`."""


class Forming:
    """The forming of one proof. Its faces are kept for later proofs of the same claims."""

    def __init__(self, context: Context) -> None:
        self.context, self.executor = context, context.executor
        self._left = context.get(LEFT_FACES)
        self._tracks: dict[tuple[str, int, tuple[str, ...]], Track] = {}
        self._faces: list[tuple[float, Face]] = context.kept.setdefault("faces", [])
        self._balls: dict[tuple[int, int], Balls] = {}
        self.by_setup: tuple[tuple[int, Claim], ...] = tuple(
            (index, claim)
            for index, setup in enumerate(context.setup_claims)
            for group in setup.groups
            for claim in now(group)
        )

    @cached_property
    def levels(self) -> tuple[OneLevel, ...]:
        """All levels that are formed alone, with their files."""
        groups = [(k, group) for k, setup in enumerate(self.context.setup_claims) for group in setup.groups]
        return levels_told(self.context.problem, groups)

    def level(self, segment: Segment, index: int) -> OneLevel | None:
        """The level that alone is formed of a segment in setup ``index``, if so; one with no operation is
        told of by its rule."""
        same = (one for one in self.levels if one.claim.segment == segment and one.index == index)
        return next((one for one in same if getattr(one.operation, "level", None) is not None), None)

    @cached_property
    def parts(self) -> tuple[tuple[PartShapes | None, tuple[Claim, ...]], ...]:
        """What each operation that forms is to make, with its passes, and all its claims; None for the part
        where nothing says what it is. One that forms some features of it finds those of others before it."""
        out: list[tuple[PartShapes | None, tuple[Claim, ...]]] = []
        before: tuple[Feature, ...] = ()
        for setup in self.context.setup_claims:
            for group in setup.groups:
                part = next((claim for claim in group if isinstance(claim, FormsPart)), None)
                passes = in_order(group)
                if part is None and not passes:
                    continue
                made = None
                if part is not None:
                    made = PartShapes(part, passes, () if part.features is None else before)
                    before = (*before, *(feature for _, feature in made.own))
                out.append((made, group))
        return tuple(out)

    def still_flat(self, group: Sequence[Claim], places: FloatArray) -> FloatArray:
        """How far (N,) [m] along z operations that come after one with this group of claims move the sheet at
        places in plan (N, 2): so much less it is moved when that one begins."""
        order = [id(one) for setup in self.context.setup_claims for one in setup.groups]
        out = np.zeros(len(places))
        for made, other in self.parts:
            if made is not None and order.index(id(other)) > order.index(id(group)):
                for _, feature in made.own:
                    out += feature.final.shift(places)
        return out

    @cached_property
    def formed(self) -> tuple[Formed, ...]:
        """All passes that are claimed, with the forming arm first and the others behind it."""
        return tuple(
            self._formed(claim, index) for index, claim in self.by_setup if isinstance(claim, FormsSheet)
        )

    @cached_property
    def opened(self) -> tuple[Opened, ...]:
        """All gaps that are claimed; without knots where the arms never form the segment together."""
        return tuple(self._opened(c, index) for index, c in self.by_setup if isinstance(c, ToolGap))

    def of(self, segment: Segment) -> Formed | None:
        """The pass of a segment, None where its tools follow a table instead of a face."""
        return next((one for one in self.formed if one.claim.segment.key == segment.key), None)

    @cached_property
    def states(self) -> tuple[tuple[int, SheetState], ...]:
        """All claims of what tools meet, with their setups."""
        return tuple((index, claim) for index, claim in self.by_setup if isinstance(claim, SheetState))

    @cached_property
    def gapped(self) -> frozenset[str]:
        """Segments in which two tools hold the sheet between them."""
        return frozenset(claim.segment.key for _, claim in self.by_setup if isinstance(claim, ToolGap))

    def unreached(self, one: Formed) -> float | None:
        """How far [m] a ball may stay off the part where it does not fit, if the problem says so and no later
        pass forms the feature further."""
        finals = [
            (made.part.unreached, claim)
            for made, _ in self.parts
            if made is not None
            for feature in made.features
            for claim in feature.final.claims
        ]
        return next((limit for limit, claim in finals if claim is one.claim), None)

    def steps(self, one: Formed) -> tuple[float | None, float | None]:
        """The stepdown and the scallop [m] of the job that a pass belongs to, one of them given; none where
        nothing says what part it is of."""
        for made, group in self.parts:
            if made is not None and any(claim is one.claim for claim in group):
                return made.part.steps
        return None, None

    @cached_property
    def labels(self) -> frozenset[str]:
        """Labels of all moves that claims allow."""
        names = [claim.segment for _, claim in self.by_setup if isinstance(claim, FormsSheet | FormsByTable)]
        return frozenset(way.key for name in names for way in name.ways)

    @cached_property
    def told(self) -> tuple[Told, ...]:
        """All claims of tools that are deeper by what the sheet comes back by, with their files."""
        return told(self.context.problem, self.by_setup)

    @cached_property
    def _released(self) -> dict[tuple[str, int], Released]:
        return released(self.told, self.levels, self.by_setup)

    def track(self, segment: Segment, index: int, arms: tuple[str, ...]) -> Track:
        """The track of a segment, of the released tools, worked out once."""
        key = (segment.key, index, arms)
        if key not in self._tracks:
            deeper = self._released.get((segment.key, index))
            self._tracks[key] = track(self.context, segment, index, arms, deeper)
        return self._tracks[key]

    def _face(self, vertices: FloatArray, faces: IntArray, scale: float) -> Face:
        """A face, worked out once for claims of the same triangles, however they number vertices."""
        corners = vertices[faces]
        for known, face in self._faces:
            if known == scale and np.array_equal(face.given, corners):
                return face
        self._faces.append((scale, Face(vertices, faces, scale)))
        return self._faces[-1][1]

    def _ball(self, way: Track, face: Face) -> Balls:
        """The forming ball on a track, worked out once for claims of the same track and face, which live as
        long as this does."""
        key = (id(way), id(face))
        if key not in self._balls:
            self._balls[key] = Balls(way, face)
        return self._balls[key]

    def _formed(self, claim: FormsSheet, index: int) -> Formed:
        arms = [arm.name for arm in self.context.setups[index].cell.arms if arm.name != claim.arm]
        arms = [arm for arm in arms if arm in self.context.motion.tcp]
        way = self.track(claim.segment, index, (claim.arm, *arms))
        parts = pieces(way, TRACK_CHORD_SHARE * claim.tolerance)
        knots = np.unique(np.concatenate([parts.first, parts.last]))
        face = self._face(claim.vertices, claim.faces, claim.radius)
        left = self._left.get(id(claim))
        level = self.level(claim.segment, index)
        return Formed(claim, index, way, parts, knots, face, self._ball(way, face), left, level)

    def _opened(self, claim: ToolGap, index: int) -> Opened:
        way = self.track(claim.segment, index, claim.arms)
        parts = pieces(way, TRACK_CHORD_SHARE * claim.tolerance)
        own = way.own[parts.first]
        parts = Pieces(parts.first[own], parts.last[own], parts.off[own], parts.apart[own])
        knots = np.unique(np.concatenate([parts.first, parts.last, _meetings(self.context, way)]))
        face = self._face(claim.vertices, claim.faces, claim.radii[0])
        balls = self._ball(way, face)
        wanted = face.value(balls.near(knots), claim.gap[claim.faces])
        return Opened(claim, way, parts, knots, face, balls, *wanted)


FORMING: Final[Fact[Context, Forming]] = Fact("forming", Forming)
"""The forming of a proof."""
