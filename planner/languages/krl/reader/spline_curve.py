"""How far a spline block's curve may be off the straight ways between its points, whatever the controller's
rule is: a bound over a family of curves.

What is known of SPL (facts of KSS 8.x, docs/krl.md): the curve goes through every point, is of the fifth
order from one to the next, and what it is at a point depends on two neighbours on each side. The family is
all of that which keeps the following; nothing of it was seen on a controller.

Poses are taken as six numbers: the TCP's position in the base, and the turn as a rotation vector in the
tool's axes at the point where the segment begins, by ``TURN_LEVER`` [m/rad]. c_k is the step of segment k,
which has the knot interval g_k. With d_k = c_k / g_k and s_k = d_k - d_(k-1) a curve of the family has on
segment i, for u from 0 to 1, the quintic Hermite form

    x(u) = u c_i + g_i (H1(u) (V_i - d_i) + H4(u) (V_(i+1) - d_i)) + g_i^2 (H2(u) A_i + H3(u) A_(i+1))

    H1 = u - 6u^3 + 8u^4 - 3u^5      H2 = u^2/2 - 3u^3/2 + 3u^4/2 - u^5/2
    H4 = -4u^3 + 7u^4 - 3u^5         H3 = u^3/2 - u^4 + u^5/2

(the Hermite interpolant of degree 5, E. Hairer and G. Wanner, Analysis by Its History, II.2; it is the unique
one, as six conditions have one solution) where at each point, and on its two sides independently,

- V_i lies between the slopes beside it, and off that by OUTER of the outer two changes of slope at most:
  V_i = (1 - t) d_(i-1) + t d_i + a s_(i-1) + b s_(i+1), t in [0, 1], |a|, |b| <= OUTER;
- A_i = (p s_(i-1) + q s_i + r s_(i+1)) 2 / (g_(i-1) + g_i), |p| + |q| + |r| <= BENDS, each s_k with its own
  2 / (g_(k-1) + g_k);
- knots: each g_k / g_i is between 1 and the ratio of the ways (uniform, by chord length, centripetal, or
  anything between them): where a spline goes does not depend on how fast it does;
- at the two ends of the block V is the one slope beside it, and off that by ENDS instead of OUTER (one-sided
  differences), and A is the one change of slope beside it at most; changes of slope that would need a
  neighbour beyond an end are 0. As the arm stands there, V and A together may be any share, from all to
  nothing, of that.

Members are, among others, Catmull-Rom and finite differences by 3 and by 5 even points (a = -b = 1/12,
A: -1/12, 7/6, -1/12), Akima's (t by weights), natural minimum-jerk splines of five even points (a = 0.103,
A: -0.175, 1.35, -0.175), flat points (A = 0). How fast it goes
between points is told by the members with knots by time that are at rest, V = A = 0, at the block's ends.

The bound: x(u) is linear in V and A, so its part across c_i is at most the sum of the |H| times the largest
parts across of V and A, and these are at corners of the family. Along c_i the curve may run over its ends by
as much as an interval says; it is then as far off the next segment, within that one's length, as the two
differ in direction over that way, and off by all of it where none is next. Suprema over u are taken on a
grid, with more than what lies between its points. Where the curve is along its way is not bounded, for that
is no other place. Segments turn by MOST_TURN at most: what rotation vectors add otherwise than numbers do is
of the third order of that, and less than what the grid's factor leaves.
"""

import dataclasses
import itertools
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, log_rotation

TURN_LEVER: Final = 0.1
"""What a turn counts as [m/rad]."""
OUTER: Final = 0.125
"""Part of the outer changes of slope in V_i."""
BENDS: Final = 2.0
"""Bound of the changes of slope in A_i together."""
ENDS: Final = 0.5
"""Part of the next change of slope in V at an end of a block."""
MOST_TURN: Final = 0.1
"""Most that a segment may turn [rad]."""
_GRID: Final = np.linspace(0.0, 1.0, 257)
"""Times of a segment, from 0 to 1, at which curves are bounded."""
_GRID_FACTOR: Final = 1.002
"""Between grid points a bound may be larger by less than this."""
_CURVED: Final = 4.0
"""The second derivatives of H1 and H4 are below this, those of H2 and H3 not above 1."""

_U = _GRID
"""The same, as formulas have it."""
_H1 = _U - 6 * _U**3 + 8 * _U**4 - 3 * _U**5
"""Quintic Hermite forms: of the slope at the start,"""
_H2 = (_U**2 - 3 * _U**3 + 3 * _U**4 - _U**5) / 2
"""of the second derivative at the start,"""
_H3 = (_U**3 - 2 * _U**4 + _U**5) / 2
"""of the second derivative at the end,"""
_H4 = -4 * _U**3 + 7 * _U**4 - 3 * _U**5
"""of the slope at the end."""
HERMITE_FORMS: Final = np.stack([_H1, _H4, _H2, _H3])
"""(4, G) what V_i, V_(i+1), A_i, A_(i+1) count on the grid."""
HERMITE_RATES: Final = np.stack(
    [
        1 - 18 * _U**2 + 32 * _U**3 - 15 * _U**4,
        -12 * _U**2 + 28 * _U**3 - 15 * _U**4,
        (2 * _U - 9 * _U**2 + 12 * _U**3 - 5 * _U**4) / 2,
        (3 * _U**2 - 8 * _U**3 + 5 * _U**4) / 2,
    ]
)
"""(4, G) their derivatives."""


@dataclasses.dataclass(frozen=True)
class Bounds:
    """Of the N segments of a block, for every curve of the family: ``off`` (N,) [m, turns by ``TURN_LEVER``]
    from the straight way, ``way`` (N,) [m] and ``turn`` (N,) [rad] alone of the same, ``speed`` (N,) [m/s]
    of the TCP, ``change`` (N,) [m/s, turns by ``TURN_LEVER``] of all speeds against the mean of the
    segment."""

    off: FloatArray
    way: FloatArray
    turn: FloatArray
    speed: FloatArray
    change: FloatArray


def bounds(pose: FloatArray, duration: FloatArray) -> Bounds:
    """Of a block through the poses (N + 1, 4, 4) [m] in its base, whose segments last ``duration`` (N,)
    [s]."""
    step = steps(pose)
    times = _neighbours(duration)
    missing = times == 0.0
    ratio = duration[:, None] / np.where(missing, duration[:, None], times)
    size = np.linalg.norm(step, axis=2)
    own = np.maximum(size[:, 2:3], 1e-12)
    by_way = np.where(size > 1e-12, own / np.maximum(size, 1e-12), 1.0)
    off, place, turn = _steps_off(step, np.minimum(1.0, by_way), np.maximum(1.0, by_way), missing)
    in_time = _curve(step, ratio, ratio, missing).at_rest(missing)
    tcp = _curve(step[:, :, :3], ratio, ratio, missing).at_rest(missing)
    return Bounds(off, place, turn / TURN_LEVER, tcp.rate() / duration, in_time.change() / duration)


def _steps_off(
    step: FloatArray, least: FloatArray, most: FloatArray, missing: BoolArray
) -> tuple[FloatArray, ...]:
    """How far (N,) [m] curves are off in all six numbers, by place, and by turn: at the ends with all of V
    and A there, or nothing, whichever is more."""
    turns = np.linalg.norm(step[:, 2, 3:], axis=1) > TURN_LEVER * MOST_TURN
    far = turns & ~missing[:, 1:4:2].all(axis=1)
    out = []
    for some in (slice(0, 6), slice(0, 3), slice(3, 6)):
        curve = _curve(step, least, most, missing, some)
        rests = [curve, *(curve.at_rest(missing, ends) for ends in ((1,), (3,), (1, 3)))]
        out.append(np.where(far, np.inf, np.max([_off(one, step, some) for one in rests], axis=0)))
    return tuple(out)


def steps(pose: FloatArray) -> FloatArray:
    """Steps (N, 5, 6) of the two segments before each of N segments, itself, and the two behind it, between
    poses (N + 1, 4, 4); turns by ``TURN_LEVER``; 0 where there is none."""
    count = len(pose) - 1
    at = np.clip(np.arange(count)[:, None] + np.arange(-2, 4), 0, count)
    seen = pose[at]
    turn = log_rotation(np.swapaxes(pose[:-1, None, :3, :3], 2, 3) @ seen[..., :3, :3])
    rows = np.concatenate([seen[..., :3, 3], TURN_LEVER * turn], axis=2)
    return np.diff(rows, axis=1)


def _neighbours(values: FloatArray) -> FloatArray:
    """Values (N, 5) of the two before each of N, itself, and the two behind it; 0 where there is none."""
    padded = np.concatenate([np.zeros(2), values, np.zeros(2)])
    return np.stack([padded[k : k + len(values)] for k in range(5)], axis=1)


@dataclasses.dataclass(frozen=True)
class _Curve:
    """Of N segments, in their own length: the parts ``across`` (N, 4) of V_i, V_(i+1), A_i, A_(i+1), and
    ``low``, ``high`` (N, 4) along, where of V the segment's own slope is taken off; ``size`` (N,) [m]."""

    across: FloatArray
    low: FloatArray
    high: FloatArray
    size: FloatArray

    def at_rest(self, missing: BoolArray, ends: tuple[int, ...] = (1, 3)) -> "_Curve":
        """The same with the arm at rest, V = A = 0, where a segment is the first (1) or last (3) one."""
        across, low, high = self.across.copy(), self.low.copy(), self.high.copy()
        for end in ends:
            rows = np.flatnonzero(missing[:, end])
            for k, value in ((end // 2, -1.0), (2 + end // 2, 0.0)):
                across[rows, k], low[rows, k], high[rows, k] = 0.0, value, value
        return _Curve(across, low, high, self.size)

    def along(self, forms: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What the terms come to along the segment (N, G), at least and at most."""
        up, down = np.maximum(forms, 0.0), np.minimum(forms, 0.0)
        return self.low @ up + self.high @ down, self.high @ up + self.low @ down

    def rate(self) -> FloatArray:
        """The most (N,) [m] that dx/du is."""
        low, high = self.along(HERMITE_RATES)
        fast = np.maximum(np.abs(1.0 + low), np.abs(1.0 + high)) * self.size[:, None]
        return np.asarray(_GRID_FACTOR * np.hypot(fast, self.across @ np.abs(HERMITE_RATES)).max(axis=1))

    def change(self) -> FloatArray:
        """The most (N,) [m] by which dx/du differs from the segment's step."""
        low, high = self.along(HERMITE_RATES)
        fast = np.maximum(np.abs(low), np.abs(high)) * self.size[:, None]
        return np.asarray(_GRID_FACTOR * np.hypot(fast, self.across @ np.abs(HERMITE_RATES)).max(axis=1))


def _off(curve: _Curve, step: FloatArray, some: slice) -> FloatArray:
    """How far (N,) [m] a curve is off the straight segments at most, in the numbers ``some`` of the steps
    (N, 5, D)."""
    size = np.linalg.norm(step, axis=2)
    unit = step / np.maximum(size, 1e-12)[:, :, None]
    across = _GRID_FACTOR * (curve.across @ np.abs(HERMITE_FORMS)).max(axis=1)
    low, high = curve.along(HERMITE_FORMS)
    bent = np.maximum(np.abs(curve.low), np.abs(curve.high)) @ np.array([_CURVED, _CURVED, 1.0, 1.0])
    between = bent * (_U[1] - _U[0]) ** 2 / 8.0
    out = np.zeros(len(step))
    for k, over in ((1, -(_U + low)), (3, _U + high - 1.0)):  # over the start, over the end
        beyond = (np.maximum(over.max(axis=1), 0.0) + between) * size[:, 2]
        follows = beyond <= size[:, k]
        apart = np.linalg.norm((unit[:, k] - unit[:, 2])[:, some], axis=1)
        out = np.maximum(out, beyond * np.where(follows, apart, np.linalg.norm(unit[:, 2, some], axis=1)))
    return np.asarray(across + out)


def _curve(
    step: FloatArray, least: FloatArray, most: FloatArray, missing: BoolArray, some: slice = slice(None)
) -> _Curve:
    """The family's corners: ``step`` (N, 5, D), ``least`` and ``most`` (N, 5) of g_i / g_k; ``missing``
    (N, 5) beyond the ends of the block. Parts across are those in the numbers ``some`` of D."""
    size = np.linalg.norm(step[:, 2], axis=1)
    way = step[:, 2] / np.maximum(size, 1e-12)[:, None]
    along = np.einsum("nkd,nd->nk", step, way)
    across = (step - along[:, :, None] * way[:, None, :])[:, :, some]
    apart = np.linalg.norm(across, axis=2)
    own = np.maximum(size, 1e-12)[:, None]
    x_low = np.minimum(least * along, most * along) / own
    x_high = np.maximum(least * along, most * along) / own
    # changes of slope between neighbours k and k + 1: corners of both knot intervals
    bend_across, bend_along = np.zeros((2, len(step), 4))
    for k, (one, two) in itertools.product(range(4), itertools.product((least, most), repeat=2)):
        change = two[:, k + 1, None] * across[:, k + 1] - one[:, k, None] * across[:, k]
        bend_across[:, k] = np.maximum(bend_across[:, k], np.linalg.norm(change, axis=1))
        shift = np.abs(two[:, k + 1] * along[:, k + 1] - one[:, k] * along[:, k]) / own[:, 0]
        bend_along[:, k] = np.maximum(bend_along[:, k], shift)
    known = ~missing[:, 1:] & ~missing[:, :-1]
    bend_across, bend_along = bend_across * known, bend_along * known
    short = 2.0 / (1.0 / most[:, :-1] + 1.0 / most[:, 1:])
    parts, lows, highs = [], [], []
    for k, (near, far) in ((1, (1, 2)), (2, (2, 3))):  # V between segments k and k + 1
        outer = np.full((len(step), 2), OUTER)
        outer[missing[:, near], 1] = ENDS  # the block's first point: the change behind it
        outer[missing[:, far], 0] = ENDS
        rows = bend_across[:, [k - 1, k + 1]], bend_along[:, [k - 1, k + 1]]
        parts.append(
            np.maximum(most[:, near] * apart[:, near], most[:, far] * apart[:, far])
            + (outer * rows[0]).sum(axis=1)
        )
        slack = (outer * rows[1]).sum(axis=1)
        one, two = (np.where(missing[:, k], o, k) for k, o in ((near, far), (far, near)))
        row = np.arange(len(step))
        lows.append(np.minimum(x_low[row, one], x_low[row, two]) - slack - 1.0)
        highs.append(np.maximum(x_high[row, one], x_high[row, two]) + slack - 1.0)
    for k in (0, 1):  # A at both ends: the three changes of slope around it
        most_bent = np.where(missing[:, 1 + 2 * k], 1.0, BENDS)
        parts.append(most_bent * (short * bend_across)[:, k : k + 3].max(axis=1))
        slack = most_bent * (short * bend_along)[:, k : k + 3].max(axis=1)
        lows.append(-slack)
        highs.append(slack)
    across, low, high = (np.stack(rows, axis=1) for rows in (parts, lows, highs))
    return _Curve(across, low, high, size)
