"""Where forming tools are while they form: their centres and axes in the sheet's frame, and the same way as
few straight pieces from which it is off by no more than a stated bound."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from planner.geometry.rigid import inverse
from planner.geometry.vectors import dots, lengths
from planner.segments import Segment
from planner.verify.context import Context
from planner.verify.poses import Poses
from planner.verify.speed import during

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_BLOCK = 32
_CHUNK = 65_536


@dataclasses.dataclass(frozen=True)
class Track:
    """T samples of the arms ``arms`` in one segment and its ways in and out.

    ``rows`` (T,) samples of the motion; ``centre`` (T, A, 3) the TCPs [m] in the sheet's frame; ``own`` (T,):
    the move under way forms, and is no way in or out; ``joined`` (T - 1,): the next row is the next sample.
    ``poses``: the arms' TCPs at all samples in the world, ``back`` (1 | T, 4, 4) from there to the sheet.
    """

    arms: tuple[str, ...]
    rows: IntArray
    centre: FloatArray
    own: BoolArray
    joined: BoolArray
    poses: tuple[Poses, ...]
    back: FloatArray

    def axis(self, column: int) -> FloatArray:
        """The z axes (T, 3) of one arm's TCP in the sheet's frame; not kept, for long tracks have many
        rows."""
        return _turned(self.back, self.poses[column].z[self.rows])


def track(context: Context, segment: Segment, index: int, arms: tuple[str, ...]) -> Track:
    """The track of a segment in setup ``index``; no rows where the programs have none, or an arm is
    missing."""
    motion = context.motion
    own = motion.node_label == segment.key
    chosen = np.isin(motion.node_label, [way.key for way in segment.ways])
    rows = np.flatnonzero(during((chosen[motion.node]) & (context.sample_setup == index)))
    if any(arm not in motion.tcp for arm in arms):
        rows = rows[:0]
    back = np.zeros((0, 4, 4))
    if len(rows):
        moved = context.holder(index) is not None
        back = inverse(context.stock_poses(index, rows if moved else rows[:1]))
    centre = np.empty((len(rows), len(arms), 3))
    for k, arm in enumerate(arms):
        if len(rows):
            centre[:, k] = _turned(back, motion.tcp[arm].place[rows]) + back[:, :3, 3]
    poses = tuple(motion.tcp[arm] for arm in arms if len(rows))
    return Track(arms, rows, centre, own[motion.node[rows]], np.diff(rows) == 1, poses, back)


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
    first = np.concatenate([np.arange(a, b, _BLOCK) for a, b in zip(starts, ends, strict=True)])
    to = np.repeat(ends, [len(range(a, b, _BLOCK)) for a, b in zip(starts, ends, strict=True)])
    last = np.minimum(first + _BLOCK, to)
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


def _off(centre: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
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


def _bend(centre: FloatArray, joined: BoolArray) -> FloatArray:
    """How far (T - 1,) [m] ``centre`` (T, A, 3) may be off the straight way between two samples (`_corner`):
    what its second differences at both are across that way; changes of speed make no bend."""
    before, behind = np.zeros((2, len(centre) - 1, centre.shape[1]))
    for begin, end in _parts(len(centre)):
        step = np.diff(centre[begin - 1 : end + 1], axis=0)
        along = step / np.maximum(lengths(step), 1e-12)[..., None]
        second = np.diff(step, axis=0)
        # what one corner between two samples makes at either is across one and the same way only so
        for out, row, way in ((behind, slice(begin - 1, end - 1), 0), (before, slice(begin, end), 1)):
            across = along[way : way + len(second)]
            out[row] = lengths(second - dots(second, across)[..., None] * across)
    return np.asarray(_corner(before, behind, joined).max(axis=1))


def _stretch(centre: FloatArray, joined: BoolArray) -> FloatArray:
    """By how much (T - 1,) [m] the distance d of the first two of ``centre`` (T, A, 3) may be off that on
    straight ways between two samples: by a deviation along their line whole, by one of e across it by
    e^2 / 2 d. Zero for one alone."""
    if centre.shape[1] < 2:
        return np.zeros(len(centre) - 1)
    line = np.zeros((len(centre), 1))
    across, apart = np.zeros_like(line), np.full_like(line, np.inf)
    for begin, end in _parts(len(centre)):
        way = centre[begin - 1 : end + 1, 0] - centre[begin - 1 : end + 1, 1]
        second, length = np.diff(way, n=2, axis=0), lengths(way[1:-1])
        own = dots(second, way[1:-1]) / np.maximum(length, 1e-12)
        line[begin:end, 0] = np.abs(own)
        across[begin:end, 0] = np.sqrt(np.maximum(dots(second, second) - own**2, 0.0))
        apart[begin:end, 0] = length
    aside = _corner(across[:-1], across[1:], joined)[:, 0]
    least = np.minimum(apart[1:, 0], apart[:-1, 0])
    along = _corner(line[:-1], line[1:], joined)[:, 0]
    return np.asarray(along + aside**2 / np.maximum(2.0 * (least - aside), 1e-6))


def _parts(count: int) -> list[tuple[int, int]]:
    """Rows from 1 to ``count`` - 1, so many at once."""
    return [(begin, min(begin + _CHUNK, count - 1)) for begin in range(1, count - 1, _CHUNK)]


def _corner(before: FloatArray, behind: FloatArray, joined: BoolArray) -> FloatArray:
    """What one sharp corner anywhere between two samples makes (T - 1, A) [m], whose second differences are
    ``before`` a and ``behind`` b (T - 1, A) there: a b / (a + b). An even bend makes a quarter of that."""
    a, b = (np.where(joined[:, None], one, 0.0) for one in (before, behind))
    a[1:][~joined[:-1]] = 0.0  # none is known across a gap
    b[:-1][~joined[1:]] = 0.0
    return np.asarray(a * b / np.maximum(a + b, 1e-30))
