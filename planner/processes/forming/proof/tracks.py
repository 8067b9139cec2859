"""Where forming tools are while they form, and few straight pieces in place of their motion."""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any, Final, Protocol

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, inverse, lengths
from planner.processes.forming.proof.released import Released
from planner.proof.context import Context
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
        yield (slice(first, min(end + 2, count)), _Here(slice(begin, end), slice(begin - first, end - first)))


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
