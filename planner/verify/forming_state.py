"""What the rules on forming share: the claims of a proof by segment, tracks and faces, each worked out
once."""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planner.claims import Claim
from planner.claims_forming import FormsByTable, FormsPart, FormsSheet, SheetState, ToolGap
from planner.segments import Segment
from planner.verify.context import Context
from planner.verify.forming_face import Face, Nearest
from planner.verify.forming_fit import left_by
from planner.verify.forming_shapes import PartShapes, in_order
from planner.verify.forming_track import Pieces, Track, pieces, track

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SPARE = 0.1
"""The straight pieces of a track are off it by this share of the tolerance at most."""


class Balls:
    """The forming ball at rows of a track: what of the face is nearest to it, each row asked once for all
    claims."""

    def __init__(self, track: Track, face: Face) -> None:
        self.track, self.face = track, face
        self._rows = np.zeros(0, dtype=np.int64)
        self._near = face.nearest(np.zeros((0, 3)), TIED)

    def near(self, rows: IntArray) -> Nearest:
        """At ``rows`` (K,) of the track, ascending; ties within `TIED`."""
        fresh = np.setdiff1d(rows, self._rows)
        if len(fresh):
            known = np.concatenate([self._rows, fresh])
            order = np.argsort(known)
            found = self.face.nearest(self.track.centre[fresh, 0], TIED)
            self._rows, self._near = known[order], self._near.followed_by(found).at(order)
        return self._near.at(np.searchsorted(self._rows, rows))


@dataclasses.dataclass(frozen=True)
class Formed:
    """The face of a pass and the way of its tools; ``knots`` (K + 1,) rows of the track where its pieces
    meet, ``near`` what of the face is nearest to the forming ball there."""

    claim: FormsSheet
    setup: int
    track: Track
    pieces: Pieces
    knots: IntArray
    face: Face
    balls: Balls

    @cached_property
    def near(self) -> Nearest:
        """What of the face is nearest to the forming ball at the knots; ties within 5 um."""
        return self.balls.near(self.knots)

    @cached_property
    def left(self) -> Face:
        """The face as the ball leaves it where it reaches no nearer: with fillets of its own radius."""
        return left_by(self.face, self.claim.radius, self.claim.side, self.claim.start)

    @cached_property
    def touches(self) -> NDArray[np.bool_]:
        """Knots (K + 1,) at which the ball is off the nearest place of the face by no more than the steps of
        the path leave there."""
        reach = self.claim.radius + self.claim.scallop[self.face.rows[self.near.triangle]]
        out = np.zeros(len(self.knots), dtype=np.bool_)
        np.logical_or.at(out, self.near.row, self.near.apart[self.near.row] <= reach + self.claim.tolerance)
        return out


@dataclasses.dataclass(frozen=True)
class Opened:
    """Two tools in one segment and the gap between them: ``pieces`` those of the segment itself, ``knots``
    (K,) rows of the track where they meet, ``near`` what of the face is nearest to the forming ball there.

    The wanted gap is between ``low`` and ``high`` (K,) [m].
    """

    claim: ToolGap
    track: Track
    pieces: Pieces
    knots: IntArray
    face: Face
    near: Nearest
    low: FloatArray
    high: FloatArray

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


TIED = 5e-6
"""Places of a face that are so near to the nearest one [m] are touched as well: facets are chords."""


class Forming:
    """The forming of one proof."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self._tracks: dict[tuple[str, int, tuple[str, ...]], Track] = {}
        self._faces: list[tuple[float, Face]] = []
        self._balls: dict[tuple[int, int], Balls] = {}
        self.by_setup: tuple[tuple[int, Claim], ...] = tuple(
            (index, claim)
            for index, setup in enumerate(context.setup_claims)
            for group in setup.groups
            for claim in group
        )

    @cached_property
    def parts(self) -> tuple[tuple[PartShapes | None, tuple[Claim, ...]], ...]:
        """What each operation that forms is to make, with its passes, and all its claims; None for the part
        where nothing says what it is."""
        out: list[tuple[PartShapes | None, tuple[Claim, ...]]] = []
        for setup in self.context.setup_claims:
            for group in setup.groups:
                part = next((claim for claim in group if isinstance(claim, FormsPart)), None)
                passes = in_order(group)
                if part is not None or passes:
                    out.append((None if part is None else PartShapes(part, passes), group))
        return tuple(out)

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

    @cached_property
    def labels(self) -> frozenset[str]:
        """Labels of all moves that claims allow."""
        names = [claim.segment for _, claim in self.by_setup if isinstance(claim, FormsSheet | FormsByTable)]
        return frozenset(way.key for name in names for way in name.ways)

    def track(self, segment: Segment, index: int, arms: tuple[str, ...]) -> Track:
        """The track of a segment, worked out once."""
        key = (segment.key, index, arms)
        if key not in self._tracks:
            self._tracks[key] = track(self.context, segment, index, arms)
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
        parts = pieces(way, SPARE * claim.tolerance)
        knots = np.unique(np.concatenate([parts.first, parts.last]))
        face = self._face(claim.vertices, claim.faces, claim.radius)
        return Formed(claim, index, way, parts, knots, face, self._ball(way, face))

    def _opened(self, claim: ToolGap, index: int) -> Opened:
        way = self.track(claim.segment, index, claim.arms)
        parts = pieces(way, SPARE * claim.tolerance)
        own = way.own[parts.first]
        parts = Pieces(parts.first[own], parts.last[own], parts.off[own], parts.apart[own])
        knots = np.unique(np.concatenate([parts.first, parts.last, _meetings(self.context, way)]))
        face = self._face(claim.vertices, claim.faces, claim.radii[0])
        near = self._ball(way, face).near(knots)
        return Opened(claim, way, parts, knots, face, near, *face.value(near, claim.gap[claim.faces]))
