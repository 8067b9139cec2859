"""What the rules on forming share: claims by segment, tracks, faces, each worked out once.

A track is where a forming tool is while it forms: its centres and axes in the sheet's frame, and
the same way as few straight pieces from which it is off by no more than a stated bound.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, Final, Protocol

import numpy as np

from planner.claims.claim import Claim
from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, inverse, lengths
from planner.processes.forming.claims import FormsByTable, FormsPart, FormsSheet, SheetState, ToolGap
from planner.processes.forming.proof.face import Face, Nearest, left_by
from planner.processes.forming.proof.level import OneLevel, now
from planner.processes.forming.proof.level import told as levels_told
from planner.processes.forming.proof.released import Released, Told, released, told
from planner.processes.forming.proof.shapes import Feature, PartShapes, in_order
from planner.proof.context import Context
from planner.proof.facts import Fact
from planner.proof.replay.motion import Poses, Rows, during

_BLOCK_SAMPLES = 32
"""Samples of a way that are bounded as one."""
SAMPLES_AT_ONCE = 65_536
"""Samples that are worked on at once."""


class ByRow(Protocol):
    """What has vectors (3,) for T rows, such as an array (T, 3), or works out those that are indexed."""

    def __len__(self) -> int: ...
    def __getitem__(self, some: Any, /) -> FloatArray: ...


@dataclasses.dataclass(frozen=True)
class WorkedOut:
    """Vectors (3,) for ``count`` rows that ``at`` works out where they are indexed."""

    count: int
    at: Callable[[Rows], FloatArray]

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, some: Rows) -> FloatArray:
        return self.at(some)


class Centres:
    """The TCPs of some arms as an array (T, A, 3) [m] in the sheet's frame, of which only what is indexed is
    worked out: of all samples of an hour it would take as much memory as the motion has for them.
    ``lifted`` (T,) [m]: what is added to z, so that they are the released tools'."""

    def __init__(
        self, rows: IntArray, poses: tuple[Poses, ...], back: FloatArray, lifted: FloatArray | None = None
    ) -> None:
        self._rows, self._poses, self._back, self._lifted = rows, poses, back, lifted
        self.shape = (len(rows), len(poses), 3)

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, some: Rows | tuple[Rows, int]) -> FloatArray:
        """Of rows ``some`` all arms, or the one named behind them."""
        chosen, column = some if isinstance(some, tuple) else (some, None)
        if column is None:
            return np.stack([self[chosen, k] for k in range(len(self._poses))], axis=-2)
        place = self._poses[column].place[self._rows[chosen]]
        if len(self._back) == 1:
            out = _turned(self._back, place) + self._back[0, :3, 3]
        else:
            back = self._back[chosen]
            out = np.asarray((back[..., :3, :3] @ place[..., None])[..., 0] + back[..., :3, 3])
        if self._lifted is not None:
            out[..., 2] += self._lifted[chosen]
        return out


@dataclasses.dataclass(frozen=True)
class Track:
    """T samples of the arms ``arms`` in one segment and its ways in and out.

    ``rows`` (T,) samples of the motion; ``centre`` (T, A, 3) the TCPs [m] in the sheet's frame; ``own`` (T,):
    the move under way forms, and is no way in or out; ``joined`` (T - 1,): the next row is the next sample.
    ``poses``: the arms' TCPs at all samples in the world, ``back`` (1 | T, 4, 4) from there to the sheet.
    Where tools are deeper by what the sheet comes back by, ``centre`` is without that: ``lifted`` (T,) [m] is
    what that adds along z, ``aside`` (T,) [m] how far the forming arm is off the way of the problem's file.
    """

    arms: tuple[str, ...]
    rows: IntArray
    centre: FloatArray | Centres
    own: BoolArray
    joined: BoolArray
    poses: tuple[Poses, ...]
    back: FloatArray
    lifted: FloatArray | None = None
    aside: FloatArray | None = None

    def commanded(self, column: int, some: Rows) -> FloatArray:
        """The TCPs (K, 3) [m] of one arm as they are moved, at rows ``some`` (K,), in the sheet's frame."""
        out = np.array(self.centre[some, column])
        if self.lifted is not None:
            out[..., 2] -= self.lifted[some]
        return out

    def centres(self, column: int) -> WorkedOut:
        """The TCPs (T, 3) [m] of one arm in the sheet's frame."""
        return WorkedOut(len(self.rows), lambda some: self.centre[some, column])

    def axes(self, column: int) -> WorkedOut:
        """The z axes (T, 3) of one arm's TCP in the sheet's frame."""
        return WorkedOut(len(self.rows), lambda some: self.axis(column, some))

    def axis(self, column: int, some: Rows = slice(None)) -> FloatArray:
        """The z axes (K, 3) of one arm's TCP in the sheet's frame, at rows ``some`` (K,), else at all; not
        kept, for long tracks have many rows."""
        back = self.back if len(self.back) == 1 else self.back[some]
        return _turned(back, self.poses[column].z[self.rows[some]])

    def turning(self, column: int) -> FloatArray:
        """How far (T - 1,) the axis of one arm goes from each row to the next, as the way of a unit vector's
        end."""
        out = np.zeros(max(len(self.rows) - 1, 0))
        for begin in range(0, len(out), SAMPLES_AT_ONCE):
            end = min(begin + SAMPLES_AT_ONCE, len(out))
            step = np.diff(self.axis(column, slice(begin, end + 1)), axis=0)
            out[begin:end] = np.linalg.norm(step, axis=1)
        return out


def track(
    context: Context, segment: Segment, index: int, arms: tuple[str, ...], deeper: Released | None = None
) -> Track:
    """The track of a segment in setup ``index``, of the released tools where they are ``deeper`` than that;
    no rows where the programs have none, or an arm is missing."""
    motion = context.motion
    own = motion.node_label == segment.key
    chosen = np.isin(motion.node_label, [way.key for way in segment.ways])
    rows = np.flatnonzero(during((chosen[motion.node]) & (context.sample_setup == index)))
    if any(arm not in motion.tcp for arm in (*arms, *([] if deeper is None else [deeper.former]))):
        rows = rows[:0]
    joined = np.diff(rows) == 1
    if not len(rows):
        none = np.zeros((0, len(arms), 3))
        return Track(arms, rows, none, own[motion.node[rows]], joined, (), np.zeros((0, 4, 4)))
    moved = context.holder(index) is not None
    back = inverse(context.stock_poses(index, rows if moved else rows[:1]))
    poses = tuple(motion.tcp[arm] for arm in arms)
    forms = own[motion.node[rows]]
    if deeper is None:
        return Track(arms, rows, Centres(rows, poses, back), forms, joined, poses, back)
    lifted, aside = _lifted(deeper, Centres(rows, (motion.tcp[deeper.former],), back), forms)
    centre = Centres(rows, poses, back, lifted)
    return Track(arms, rows, centre, forms, joined, poses, back, lifted, aside)


STRAIGHT_OUT: Final = 1e-4
"""Tools are straight above a place where they are off it in plan by no more [m]."""


def _lifted(deeper: Released, former: Centres, forms: BoolArray) -> tuple[FloatArray, FloatArray]:
    """What is added along z (T,) [m] to tools that are deeper, and how far (T,) [m] the former is off the
    file's way. On the way in that is what the way begins with, on the way out what it ends with, where the
    former is straight above that place: elsewhere the sheet is as it was, and tools are where they are."""
    shift, aside = np.zeros(len(former)), np.zeros(len(former))
    own = np.flatnonzero(forms)
    if len(own):
        for some in np.array_split(own, len(own) // SAMPLES_AT_ONCE + 1):
            shift[some], aside[some] = deeper.deeper.at(former[some, 0])
        for end, air in ((0, np.arange(own[0])), (-1, np.arange(own[-1] + 1, len(former)))):
            place = former[own[end], 0]
            for some in np.array_split(air, len(air) // SAMPLES_AT_ONCE + 1):
                above = lengths(former[some, 0][:, :2] - place[:2]) <= STRAIGHT_OUT
                shift[some] = np.where(above, deeper.deeper.way.shift[end], 0.0)
    return deeper.lifted(shift), aside


def _turned(back: FloatArray, directions: FloatArray) -> FloatArray:
    """Directions (T, 3) of the world as seen from the sheet; ``back`` (1 | T, 4, 4)."""
    if len(back) == 1:
        return directions @ back[0, :3, :3].T
    return np.asarray(np.einsum("sij,sj->si", back[:, :3, :3], directions))


@dataclasses.dataclass(frozen=True)
class Pieces:
    """K straight pieces of a track: from row ``first`` to row ``last`` (K,) of it, with ``off`` (K,) [m], how
    far the way between them is off the straight one at most, both arms at one share of their pieces, and
    ``apart`` (K,) [m], by how much the distance of the first two arms is another than on straight ways."""

    first: IntArray
    last: IntArray
    off: FloatArray
    apart: FloatArray


def pieces(way: Track, within: float) -> Pieces:
    """The track in straight pieces that are off it by ``within`` [m] at most at its samples. Between samples
    the motion bends by what its second differences tell."""
    count = len(way.rows)
    if count < 2:
        none = np.zeros(0, dtype=np.int64)
        return Pieces(none, none, np.zeros(0), np.zeros(0))
    cut = np.flatnonzero(~way.joined)
    turn = np.flatnonzero((way.own[1:] != way.own[:-1]) & way.joined) + 1  # ends one piece and begins another
    starts = np.sort(np.concatenate([[0], cut + 1, turn]))
    ends = np.sort(np.concatenate([cut, turn, [count - 1]]))
    first = np.concatenate([np.arange(a, b, _BLOCK_SAMPLES) for a, b in zip(starts, ends, strict=True)])
    to = np.repeat(ends, [len(range(a, b, _BLOCK_SAMPLES)) for a, b in zip(starts, ends, strict=True)])
    last = np.minimum(first + _BLOCK_SAMPLES, to)
    done_first, done_last = [], []
    while len(first):
        good = (last - first == 1) | (_off(way.centre, first, last) <= within)
        done_first.append(first[good])
        done_last.append(last[good])
        first, last = first[~good], last[~good]
        middle = (first + last) // 2
        first, last = np.concatenate([first, middle]), np.concatenate([middle, last])
    first, last = np.concatenate(done_first), np.concatenate(done_last)
    order = np.argsort(first)
    first, last = first[order], last[order]
    bends = _bend(way.centre, way.joined), _stretch(way.centre, way.joined)
    most, between = (
        np.maximum.reduceat(np.append(bend, 0.0), first) if len(first) else np.zeros(0) for bend in bends
    )
    return Pieces(first, last, within + most, 2.0 * within + between)


def _off(centre: FloatArray | Centres, first: IntArray, last: IntArray) -> FloatArray:
    """How far (K,) [m] the rows between two are off the straight way between these."""
    out = np.zeros(len(first))
    for some in np.array_split(np.arange(len(first)), max(1, len(first) // 4000)):
        if not len(some):
            continue
        span = int((last[some] - first[some]).max())
        rows = np.minimum(first[some, None] + np.arange(span + 1), last[some, None])
        start = centre[first[some]][:, None]
        way = centre[last[some]][:, None] - start
        rest = centre[rows] - start
        square = np.maximum(dots(way, way).sum(axis=2), 1e-30)
        share = np.clip(dots(rest, way).sum(axis=2) / square, 0.0, 1.0)
        out[some] = lengths(rest - share[..., None, None] * way).max(axis=(1, 2))
    return out


def _bend(centre: FloatArray | Centres, joined: BoolArray) -> FloatArray:
    """How far (T - 1,) [m] ``centre`` (T, A, 3) may be off the straight way between two samples (`_corner`):
    what its second differences at both are across that way; changes of speed make no bend."""
    out = np.zeros(len(centre) - 1)
    for some, here in _steps(len(centre)):
        step = np.diff(centre[some], axis=0)
        along = step / np.maximum(lengths(step), 1e-12)[..., None]
        second = np.diff(step, axis=0)
        before, behind = np.zeros((2, *step.shape[:2]))
        # what one corner between two samples makes at either is across one and the same way only so
        for one, ways, way in ((behind[:-1], along[:-1], second), (before[1:], along[1:], second)):
            one[:] = lengths(way - dots(way, ways)[..., None] * ways)
        out[here.kept] = _corner(before[here.own], behind[here.own], joined, here.kept).max(axis=1)
    return out


def _stretch(centre: FloatArray | Centres, joined: BoolArray) -> FloatArray:
    """By how much (T - 1,) [m] the distance d of the first two of ``centre`` (T, A, 3) may be off that on
    straight ways between two samples: by a deviation along their line whole, by one of e across it by
    e^2 / 2 d. Zero for one alone."""
    out = np.zeros(len(centre) - 1)
    if centre.shape[1] < 2:
        return out
    for some, here in _steps(len(centre)):
        both = centre[some]
        way = both[:, 0] - both[:, 1]
        line, across = np.zeros((2, len(way), 1))
        apart = np.full((len(way), 1), np.inf)
        second, length = np.diff(way, n=2, axis=0), lengths(way[1:-1])
        own = dots(second, way[1:-1]) / np.maximum(length, 1e-12)
        line[1:-1, 0] = np.abs(own)
        across[1:-1, 0] = np.sqrt(np.maximum(dots(second, second) - own**2, 0.0))
        apart[1:-1, 0] = length
        aside = _corner(across[:-1][here.own], across[1:][here.own], joined, here.kept)[:, 0]
        least = np.minimum(apart[1:, 0], apart[:-1, 0])[here.own]
        along = _corner(line[:-1][here.own], line[1:][here.own], joined, here.kept)[:, 0]
        out[here.kept] = along + aside**2 / np.maximum(2.0 * (least - aside), 1e-6)
    return out


@dataclasses.dataclass(frozen=True)
class _Here:
    """Steps of a track that are worked out together: ``kept`` of all steps, ``own`` of those looked at."""

    kept: slice
    own: slice


def _steps(count: int) -> Iterator[tuple[slice, _Here]]:
    """Steps between ``count`` samples, so many at once: the samples that are looked at, one more at either
    end where there is one, and which steps these are."""
    for begin in range(0, count - 1, SAMPLES_AT_ONCE):
        end = min(begin + SAMPLES_AT_ONCE, count - 1)
        first = max(begin - 1, 0)
        yield (
            slice(first, min(end + 2, count)),
            _Here(slice(begin, end), slice(begin - first, end - first)),
        )


def _corner(before: FloatArray, behind: FloatArray, joined: BoolArray, steps: slice) -> FloatArray:
    """What one sharp corner anywhere between two samples makes (K, A) [m], whose second differences are
    ``before`` a and ``behind`` b (K, A) there: a b / (a + b). An even bend makes a quarter of that. ``steps``
    are these of all, which are ``joined`` (T - 1,) where they have a next sample."""
    own = joined[steps]
    past = np.concatenate([[True], joined[:-1]])[steps]  # none is known across a gap
    next_ = np.concatenate([joined[1:], [True]])[steps]
    a = np.where((own & past)[:, None], before, 0.0)
    b = np.where((own & next_)[:, None], behind, 0.0)
    return np.asarray(a * b / np.maximum(a + b, 1e-30))


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
