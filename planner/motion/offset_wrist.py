"""Inverse kinematics of arms with an offset wrist, batched over poses: six axes as of an ortho-parallel
arm, of which 4 and 5 meet and 6 passes beside that point, as those of ABB's GoFa and Fanuc's CRX.

There is no closed form; there is a search over one angle. Theta 6 says where axes 4 and 5 meet. From
there on theta 1 (two ways) and theta 2 and 3 (two ways) follow in closed form, and one condition is left:
axis 5 square to axis 4. As a function of theta 6 it is smooth for each of the four ways, up to the ends of
what the elbow reaches, where two ways meet in one value. It is sampled at :data:`NODES` angles and at these
ends, and densely where the wrist's centre passes close by axis 1, which turns theta 1 at once; changes of its
sign are refined, and so are dips that may hold two roots. A pose has up to 16 solutions.

A branch is the number 4 * (the condition rises there) + 2 * shoulder + elbow + 8 * rank: the condition
rises or falls as the determinant of the Jacobian is positive or negative, so that a number goes on as long as
the arm passes no singular posture and no stretched elbow. Where several solutions share the first three, rank
counts them, nearest to the wrist's centre line first; it is no property of an arm in motion, so a path is
followed from posture to posture by :func:`followed`.
"""

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from planner.catalogue.robots import OffsetParameters
from planner.cell.kinematics import flange_poses, form_jacobian
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, log_rotation

RANKS: Final = OffsetParameters.branches // 8
"""Solutions of one sort of which each has a branch."""
NODES: Final = 180
"""Angles of theta 6 at which the condition is looked at first."""
EXACT: Final = 1e-10
"""Solutions are nearer than this to their pose [m and rad], or put right until they are."""
POSES_AT_ONCE: Final = 256
"""Poses whose samples are in memory at once."""
_STEPS: Final = 60
"""Steps of a search between two angles at most."""


def inverse_kinematics(form: OffsetParameters, flange: FloatArray, branches: Sequence[int]) -> FloatArray:
    """Joint angles (..., len(branches), 6) [rad] of flange poses (..., 4, 4) in the base; NaN where none
    exists. Angles are not wrapped into limits."""
    poses = form.inner(flange).reshape(-1, 4, 4)
    slots = np.full(8 * RANKS, -1)
    slots[list(branches)] = np.arange(len(branches))
    out = np.full((len(poses), len(branches), 6), np.nan)
    for first in range(0, len(poses), POSES_AT_ONCE):
        row, branch, theta = _all(form, poses[first : first + POSES_AT_ONCE])
        wanted = np.flatnonzero(slots[branch] >= 0)
        out[first + row[wanted], slots[branch[wanted]]] = (theta[wanted] + form.offsets) * form.signs
    return out.reshape(*flange.shape[:-2], len(branches), 6)


class _Condition:
    """The condition at poses (P, 4, 4) of the form's own flange, or a part of them."""

    def __init__(self, form: OffsetParameters, pose: FloatArray) -> None:
        self.form = form
        self.ex, self.ey = pose[:, :3, 0].T[..., None], pose[:, :3, 1].T[..., None]
        self.foot = (pose[:, :3, 3] - form.c4 * pose[:, :3, 2] - np.array([0.0, 0.0, form.c1])).T[..., None]
        self.forearm = float(np.hypot(form.a2, form.c3))

    def of(self, rows: IndexArray) -> "_Condition":
        """That at some of the poses, which may come more than once."""
        some = object.__new__(_Condition)
        some.form, some.forearm = self.form, self.forearm
        some.ex, some.ey, some.foot = self.ex[:, rows], self.ey[:, rows], self.foot[:, rows]
        return some

    def parts(self, angle: FloatArray, shoulder: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Of theta 6 (..., K): the cosine at which the forearm leans from the line shoulder to wrist,
        beyond 1 out of reach, and what axis 5 has along this line and across it, both turned by the
        forearm's own lean. ``shoulder``: 1 in front, -1 behind."""
        p = self.form
        c, s = np.cos(angle), np.sin(angle)
        y = s * self.ex + c * self.ey
        centre = self.foot - p.a3 * (c * self.ex - s * self.ey) - p.b3 * y
        x, side, up = centre
        with np.errstate(invalid="ignore", divide="ignore"):
            ahead = shoulder * np.sqrt(x * x + side * side)
            front = (x * y[0] + side * y[1]) / ahead
            out = ahead - p.a1
            far = out * out + up * up
            long = np.sqrt(far)
            cosine = (far + self.forearm**2 - p.c2**2) / (2.0 * self.forearm * long)
            u, v = out / long, up / long
        lean_c, lean_s = p.c3 / self.forearm, p.a2 / self.forearm
        # the line elbow to wrist's centre leans from axis 4 by atan2(a2, c3)
        tilted, risen = lean_c * front + lean_s * y[2], lean_c * y[2] - lean_s * front
        return cosine, tilted * u + risen * v, tilted * v - risen * u

    def beside_axis1(self, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """At theta 6 (..., K): where the wrist's centre is in plan from axis 1 (2, ..., K), and how it goes
        on with theta 6."""
        p = self.form
        c, s = np.cos(angle), np.sin(angle)
        one, two = p.a3 * self.ex[:2] + p.b3 * self.ey[:2], p.b3 * self.ex[:2] - p.a3 * self.ey[:2]
        return np.asarray(self.foot[:2] - c * one - s * two), np.asarray(s * one - c * two)

    def leaving(self, angle: FloatArray) -> FloatArray:
        """Above 0 where the wrist's centre goes away from axis 1 with theta 6 (..., K)."""
        place, way = self.beside_axis1(angle)
        return np.asarray((place * way).sum(axis=0))

    def room(self, angle: FloatArray, shoulder: FloatArray) -> FloatArray:
        """Above 0 in reach, below 0 out of it."""
        return _room(self.parts(angle, shoulder)[0])

    def value(self, angle: FloatArray, shoulder: FloatArray, elbow: FloatArray) -> FloatArray:
        """The condition; next to the end of reach that at the end. ``elbow``: 1 or -1."""
        cosine, along, across = self.parts(angle, shoulder)
        sine = np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0))
        return np.asarray(cosine * along + elbow * sine * across)

    def joints(self, angle: FloatArray, shoulder: FloatArray, elbow: FloatArray) -> FloatArray:
        """Theta 1 to 6 (P, 6) at theta 6 (P, 1) of each pose."""
        p = self.form
        c, s = np.cos(angle), np.sin(angle)
        x5, y5 = c * self.ex - s * self.ey, s * self.ex + c * self.ey
        x, side, up = self.foot - p.a3 * x5 - p.b3 * y5
        ahead = shoulder * np.sqrt(x * x + side * side)
        theta1 = np.arctan2(shoulder * side, shoulder * x)
        cosine = self.parts(angle, shoulder)[0]
        line = np.arctan2(ahead - p.a1, up) + elbow * np.arccos(np.clip(cosine, -1.0, 1.0))
        theta2 = np.arctan2(ahead - p.a1 - self.forearm * np.sin(line), up - self.forearm * np.cos(line))
        tilt = line - np.arctan2(p.a2, p.c3)
        c1, s1, ct, st = np.cos(theta1), np.sin(theta1), np.cos(tilt), np.sin(tilt)
        axis4 = np.stack([c1 * st, s1 * st, ct])
        across = np.stack([c1 * ct, s1 * ct, -st])
        theta4 = np.arctan2(-np.sum(across * y5, axis=0), -s1 * y5[0] + c1 * y5[1])
        z5 = np.cross(x5, y5, axis=0)
        theta5 = np.arctan2(-np.sum(axis4 * x5, axis=0), np.sum(axis4 * z5, axis=0))
        return np.concatenate([theta1, theta2, tilt - theta2, theta4, theta5, angle], axis=1)


def _room(cosine: FloatArray) -> FloatArray:
    return np.where(np.isnan(cosine), -1.0, 1.0 - cosine * cosine)


_Brackets = tuple[IndexArray, FloatArray, FloatArray, FloatArray, FloatArray]
"""Poses, shoulders, elbows and two angles (M,) between which the condition changes its sign once."""


def _all(form: OffsetParameters, pose: FloatArray) -> tuple[IndexArray, IndexArray, FloatArray]:
    """Pose, branch and theta (M, 6) of all solutions of poses (P, 4, 4) of the form's own flange."""
    condition = _Condition(form, pose)
    passes = _passes(condition)
    found = [_brackets(condition, shoulder, passes) for shoulder in (1.0, -1.0)]
    row, shoulder, elbow, low, high = (np.concatenate(parts) for parts in zip(*found, strict=True))
    own, s, e = condition.of(row), shoulder[:, None], elbow[:, None]
    angle = _zero(lambda t, k: own.of(k).value(t, s[k], e[k]), low, high)
    theta = own.joints(angle[:, None], s, e)
    step = 1e-6
    slope = own.value(angle[:, None] + step, s, e) - own.value(angle[:, None] - step, s, e)
    slope = slope[:, 0] / (2.0 * step)
    theta, good = _exact(form, theta, pose[row])
    branch = 4 * (slope > 0.0) + 2 * (shoulder < 0.0) + (elbow > 0.0)
    order = np.lexsort((-np.abs(slope), branch, row))
    order = order[good[order]]
    row, branch, theta = row[order], branch[order], theta[order]
    # a root at the border of two kinds of samples may have been found by both
    twice = (np.diff(row) == 0) & (np.abs(np.diff(theta, axis=0)).max(axis=1, initial=0.0) < _ONE_SOLUTION)
    fresh = np.append(True, ~twice)[: len(row)]
    row, branch, theta = row[fresh], branch[fresh], theta[fresh]
    same = np.append(False, (np.diff(row) == 0) & (np.diff(branch) == 0))
    start = np.maximum.accumulate(np.where(same, 0, np.arange(len(row))))
    rank = np.arange(len(row)) - start
    kept = rank < RANKS
    return row[kept], (branch + 8 * rank)[kept], theta[kept]


_Passes = tuple[IndexArray, IndexArray, FloatArray, FloatArray]
"""Poses, the sample before, theta 6, and the width in theta 6 (M,) of where the wrist's centre passes close
by axis 1: it turns about it by half a right angle over this width."""


def _passes(condition: _Condition) -> _Passes:
    """Where the wrist's centre passes so close by axis 1 that the samples are too far apart."""
    angle, step = _FIRST + 2.0 * np.pi * np.arange(NODES) / NODES, 2.0 * np.pi / NODES
    leaving = condition.leaving(angle) > 0.0
    row, at = np.nonzero(~leaving & np.roll(leaving, -1, axis=1))
    own = condition.of(row)
    middle = _zero(lambda t, k: own.of(k).leaving(t), angle[at], angle[at] + step)
    place, way = (np.linalg.norm(part[..., 0], axis=0) for part in own.beside_axis1(middle[:, None]))
    close = place < _CLOSE * step * way
    row, at, middle, place, way = row[close], at[close], middle[close], place[close], way[close]
    return row, at, middle, np.maximum(place / way, _LEAST_WIDTH)


def _brackets(condition: _Condition, shoulder: float, passes: _Passes) -> _Brackets:
    """Where the condition changes its sign, on one side of axis 1."""
    angle = _FIRST + 2.0 * np.pi * np.arange(NODES) / NODES
    step = 2.0 * np.pi / NODES
    side = np.array(shoulder)
    cosine, along, across = condition.parts(angle, side)
    room = _room(cosine)
    inside = room >= 0.0
    with np.errstate(invalid="ignore"):
        sine = np.sqrt(room)
    out: list[_Brackets] = []

    def add(row: IndexArray, elbow: float, low: FloatArray, high: FloatArray) -> None:
        out.append((row, np.full(len(row), shoulder), np.full(len(row), elbow), low, high))

    ends = _ends(condition, shoulder, angle, room, inside)
    dense, dense_row, dense_at = _dense(condition, shoulder, passes)
    own = condition.of(dense_row)
    between, around = np.zeros_like(inside), np.zeros_like(inside)
    for shift in (-1, 0, 1, 2):
        around[dense_row, (dense_at + shift) % NODES] = True
        between[dense_row, (dense_at + min(shift, 1)) % NODES] = True
    for elbow in (-1.0, 1.0):
        value = cosine * along + elbow * sine * across
        after = np.roll(value, -1, axis=1)
        changes = ((value > 0.0) != (after > 0.0)) & inside & np.roll(inside, -1, axis=1)
        row, at = np.nonzero(changes & ~between)
        add(row, elbow, angle[at], angle[at] + step)
        turns = _turns_back(np.stack([np.roll(value, 1, axis=1), value, after], axis=2))[..., 0]
        row, at = np.nonzero(turns & ~around)
        for some, low, high in _dips(condition, row, angle[at] - step, angle[at] + step, shoulder, elbow):
            add(some, elbow, low, high)
        value = own.value(dense, side, np.array(elbow))
        value[own.room(dense, side) < 0.0] = np.nan
        one, at = np.nonzero((value[:, 2:-1] > 0.0) != (value[:, 1:-2] > 0.0))
        add(dense_row[one], elbow, dense[one, at + 1], dense[one, at + 2])
        one, at = np.nonzero(_turns_back(value, dense))
        low, high = dense[one, at], dense[one, at + 2]
        for some, first, second in _dips(condition, dense_row[one], low, high, shoulder, elbow):
            add(some, elbow, first, second)
        for row, near, end in ends:
            # places ever nearer to the end, where the condition goes as a root, and on to the angle before
            places = end[:, None] + (near - end)[:, None] * np.linspace(0.0, 1.0, _PLACES) ** 2
            back = (
                near[:, None] + np.where(near > end, step, -step)[:, None] * np.arange(1, _BACK + 1) / _BACK
            )
            places = np.concatenate([places, back], axis=1)
            value = condition.of(row).value(places, side, np.array(elbow))
            value[:, _PLACES:][condition.of(row).room(back, side) < 0.0] = np.nan
            above = value > 0.0
            changes = (above[:, 1:] != above[:, :-1]) & np.isfinite(value[:, 1:]) & np.isfinite(value[:, :-1])
            # between two samples one change of sign has been seen already
            changes[:, _PLACES - 1 :] &= (above[:, _PLACES - 1] == above[:, -1])[:, None]
            one, at = np.nonzero(changes)
            add(row[one], elbow, places[one, at], places[one, at + 1])
            one, at = np.nonzero(_turns_back(value, places))
            low, high = places[one, at], places[one, at + 2]
            for some, first, second in _dips(condition, row[one], low, high, shoulder, elbow):
                add(some, elbow, first, second)
    return tuple(np.concatenate(parts) for parts in zip(*out, strict=True))  # type: ignore[return-value]


def _dense(
    condition: _Condition, shoulder: float, passes: _Passes
) -> tuple[FloatArray, IndexArray, IndexArray]:
    """Angles (M, K) over the three gaps of the samples about passes, evenly in the angle about axis 1, with a
    sample before and one behind; poses and the sample before the pass (M,). Not where reach ends there."""
    row, at, middle, width = passes
    step = 2.0 * np.pi / NODES
    low = _FIRST + step * (at - 1)
    first, last = (np.arctan((end - middle) / width) for end in (low, low + 3.0 * step))
    turn = first[:, None] + (last - first)[:, None] * np.linspace(0.0, 1.0, _TURNS)
    angle = middle[:, None] + width[:, None] * np.tan(turn)
    angle[:, 0], angle[:, -1] = low, low + 3.0 * step
    angle = np.concatenate([low[:, None] - step, angle, low[:, None] + 4.0 * step], axis=1)
    room = condition.of(row).room(angle, np.array(shoulder))
    good = (room[:, 1:-1] >= 0.0).all(axis=1)
    return angle[good], row[good], at[good]


def _turns_back(value: FloatArray, angle: FloatArray | None = None) -> BoolArray:
    """Of values (..., K) at angles (..., K) in a row, even ones if none are given, at which (..., K - 2) of
    those between they come so near to zero and turn back that they may pass it: what leads there on one side
    would lead through zero on the other."""
    before, here, after = value[..., :-2], value[..., 1:-1], value[..., 2:]
    size, one, two = np.abs(here), np.abs(before), np.abs(after)
    with np.errstate(invalid="ignore", divide="ignore"):
        gaps = None if angle is None else np.abs(np.diff(angle, axis=-1))
        longer = 1.0 if gaps is None else gaps[..., 1:] / gaps[..., :-1]
        dip = (here * after > 0.0) & (here * before > 0.0) & (size <= one) & (size <= two)
        return np.asarray(dip & (size < np.fmax((one - size) * longer, (two - size) / longer)))


def _ends(
    condition: _Condition, shoulder: float, angle: FloatArray, room: FloatArray, inside: BoolArray
) -> list[tuple[IndexArray, FloatArray, FloatArray]]:
    """Poses, the angle next to an end of reach that is in it, and the end."""
    step = 2.0 * np.pi / NODES
    out = []
    for way in (1, -1):
        row, at = np.nonzero(inside & ~np.roll(inside, -way, axis=1))
        near = angle[at]
        own = condition.of(row)
        far = near + way * step
        end = _zero(lambda t, k: own.of(k).room(t, np.array(shoulder)), near, far)  # noqa: B023
        out.append((row, near, end))
    # what is in reach between two angles that are not
    before, after = np.roll(room, 1, axis=1), np.roll(room, -1, axis=1)
    row, at = np.nonzero(~inside & (room >= before) & (room >= after) & (room > -_NARROW))
    if len(row):
        own = condition.of(row)
        top = _least(lambda t: -own.room(t, np.array(shoulder)), angle[at] - step, angle[at] + step)
        good = own.room(top[:, None], np.array(shoulder))[:, 0] > 0.0
        row, top = row[good], top[good]
        own = condition.of(row)
        for sign in (1.0, -1.0):
            end = _zero(lambda t, k: own.of(k).room(t, np.array(shoulder)), top, top + sign * step)
            out.append((row, top, end))
    return out


def _dips(
    condition: _Condition, row: IndexArray, low: FloatArray, high: FloatArray, shoulder: float, elbow: float
) -> list[tuple[IndexArray, FloatArray, FloatArray]]:
    """Of angles between which the condition comes near to zero and turns back: where it passes it twice."""
    if not len(row):
        return []
    own, s, e = condition.of(row), np.array(shoulder), np.array(elbow)
    sign = np.sign(own.value(low[:, None], s, e))
    top = _least(lambda t: own.value(t, s, e) * sign, low, high)
    passed = (own.value(top[:, None], s, e) * sign)[:, 0] <= 0.0
    return [(row[passed], low[passed], top[passed]), (row[passed], top[passed], high[passed])]


_FIRST: Final = 0.0123
"""First angle: symmetric arms have solutions at whole parts of a turn, which stay off the samples so."""
_PLACES: Final = 10
"""Places that are looked at between the end of reach and the angle next to it."""
_BACK: Final = 4
"""Places from there to the angle before it."""
_CLOSE: Final = 3.0
"""Gaps between the samples below which the width of a pass by axis 1 has samples of its own."""
_LEAST_WIDTH: Final = 1e-9
"""Least width [rad] of a pass by axis 1; there theta 1 is as good as free."""
_TURNS: Final = 48
"""Angles about a pass by axis 1."""
_ONE_SOLUTION: Final = 1e-8
"""Solutions that are as near [rad] are one."""
_NARROW: Final = 0.02
"""How far the squared cosine is beyond 1 at most where a narrow reach is looked for."""
_GOLDEN: Final = 0.5 * (3.0 - 5.0**0.5)


def _least(function: Callable[[FloatArray], FloatArray], low: FloatArray, high: FloatArray) -> FloatArray:
    """Where between angles (M,) functions (M,) of one angle (M, 1) are least, by golden section."""
    for _ in range(30):
        one, two = low + _GOLDEN * (high - low), high - _GOLDEN * (high - low)
        left = function(one[:, None])[:, 0] < function(two[:, None])[:, 0]
        low, high = np.where(left, low, one), np.where(left, two, high)
    return np.asarray(0.5 * (low + high))


def _zero(
    function: Callable[[FloatArray, IndexArray], FloatArray], low: FloatArray, high: FloatArray
) -> FloatArray:
    """Zeros (M,) of functions between two angles (M,) at which their signs differ: false position of
    Illinois, halved where that is slow. ``function`` takes angles (K, 1) and which functions (K,) are
    meant."""
    low, high = low.copy(), high.copy()
    every = np.arange(len(low))
    at_low, at_high = function(low[:, None], every)[:, 0], function(high[:, None], every)[:, 0]
    out = np.where(at_low == 0.0, low, high)
    side = np.zeros(len(low), dtype=np.intp)
    open_ = np.flatnonzero((at_low != 0.0) & (at_high != 0.0))
    for count in range(_STEPS):
        if not len(open_):
            break
        a, b, fa, fb = low[open_], high[open_], at_low[open_], at_high[open_]
        with np.errstate(invalid="ignore", divide="ignore"):
            middle = b - fb * (b - a) / (fb - fa)
        if count % 4 == 3:
            middle = 0.5 * (a + b)
        middle = np.where(np.isfinite(middle), middle, 0.5 * (a + b))
        value = function(middle[:, None], open_)[:, 0]
        up = (value > 0.0) == (fb > 0.0)
        again = np.where(up, 1, -1) == side[open_]
        low[open_], high[open_] = np.where(up, a, middle), np.where(up, middle, b)
        at_low[open_] = np.where(up, np.where(again, 0.5 * fa, fa), value)
        at_high[open_] = np.where(up, value, np.where(again, 0.5 * fb, fb))
        side[open_] = np.where(up, 1, -1)
        out[open_] = middle
        open_ = open_[(value != 0.0) & (np.abs(high[open_] - low[open_]) > 1e-15) & (np.abs(value) > 1e-16)]
    return out


def _exact(form: OffsetParameters, theta: FloatArray, pose: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Theta (M, 6) put right by Newton's method where it is off its pose (M, 4, 4), and where that worked."""
    inner = dataclasses.replace(form, left=None, right=None, offsets=np.zeros(6), signs=np.ones(6))
    off = np.abs(flange_poses(inner, theta) - pose).max(axis=(1, 2), initial=0.0)
    some = np.flatnonzero(off > 0.01 * EXACT)  # not where there is none
    if len(some):
        theta, off = theta.copy(), off.copy()
        theta[some], off[some] = _newton(inner, theta[some], pose[some])
    return theta, off <= EXACT


def _newton(form: OffsetParameters, q: FloatArray, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Joints (M, 6) after steps towards poses (M, 4, 4), and how far off they are."""
    q = q.copy()
    off = np.full(len(q), np.inf)
    open_ = np.arange(len(q))
    for _ in range(_NEWTON):
        here = flange_poses(form, q[open_])
        off[open_] = np.abs(here - pose[open_]).max(axis=(1, 2))
        left = ~(off[open_] <= 0.01 * EXACT)
        open_, here = open_[left], here[left]
        if not len(open_):
            break
        turn = (
            here[:, :3, :3]
            @ log_rotation(np.swapaxes(here[:, :3, :3], 1, 2) @ pose[open_, :3, :3])[..., None]
        )
        twist = np.concatenate([turn[..., 0], pose[open_, :3, 3] - here[:, :3, 3]], axis=1)
        jac = form_jacobian(form, q[open_])
        step = np.einsum("mij,mj->mi", np.linalg.pinv(jac, rcond=1e-9), twist)
        q[open_] += step * np.minimum(1.0, _MOST_STEP / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
    return q, off


def followed(form: OffsetParameters, flange: FloatArray, near: FloatArray) -> FloatArray:
    """Joints (..., 6) of flange poses (..., 4, 4) in the base that go on from joints ``near`` (..., 6); NaN
    where Newton's method does not lead to any that are within :data:`NEAR` of them."""
    start = np.broadcast_to(near, (*flange.shape[:-2], 6))
    q, off = _newton(form, start.reshape(-1, 6), flange.reshape(-1, 4, 4))
    with np.errstate(invalid="ignore"):
        lost = ~((off <= EXACT) & (np.abs(q - start.reshape(-1, 6)).max(axis=1, initial=0.0) <= NEAR))
    q[lost] = np.nan
    return q.reshape(start.shape)


def joined(q: FloatArray) -> FloatArray:
    """Joints (N, S, branches, 6) of :func:`inverse_kinematics` at N targets with S samples, ranks put so that
    each goes on from target to target as near as can be, and from sample to sample at the first one."""
    out = q.copy()
    sorts = out.reshape(*q.shape[:2], RANKS, 8, 6)
    first = sorts[0]
    for s in range(1, q.shape[1]):
        first[s] = _next(first[None, s - 1], first[None, s])[0]
    last = first.copy()
    for row in sorts[1:]:
        row[:] = _next(last, row)
        last = np.where(np.isnan(row), last, row)
    return out


def _next(before: FloatArray, here: FloatArray) -> FloatArray:
    """Joints ``here`` (S, RANKS, 8, 6) with ranks as in ``before``, where that is nearest."""
    turn = np.abs(before[:, :, None] - here[:, None])
    gap = np.minimum(np.abs(turn - 2.0 * np.pi * np.round(turn / (2.0 * np.pi))).max(axis=-1), 1.0)
    gap = np.where(np.isnan(gap), 1.0, gap)  # (S, before, here, 8)
    ways = list(itertools.permutations(range(RANKS)))
    cost = np.stack([np.sum([gap[:, k, way[k]] for k in range(RANKS)], axis=0) for way in ways])
    best = np.array(ways)[np.argmin(cost, axis=0)]  # (S, 8, RANKS)
    return np.take_along_axis(here, np.moveaxis(best, 2, 1)[..., None], axis=1)


def singularities(form: OffsetParameters, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Angles (...,) [rad] of joints (..., 6): that whose sine is what the determinant of the Jacobian has
    left beside the other two (with axis 6 through the point where 4 and 5 meet that of axis 5), the elbow
    from stretched or folded, and under which the stretched arm would see the distance of the point where
    axes 4 and 5 meet from axis 1."""
    theta = form.signs * q - form.offsets
    forearm = float(np.hypot(form.a2, form.c3))
    bend = theta[..., 2] + np.arctan2(form.a2, form.c3)
    out = form.a1 + form.c2 * np.sin(theta[..., 1]) + forearm * np.sin(theta[..., 1] + bend)
    wrist = np.full(q.shape[:-1], np.nan)
    there = np.isfinite(theta).all(axis=-1)  # most branches of most poses are none
    size = np.abs(np.linalg.det(form_jacobian(form, q[there])))
    scale = form.c2 * forearm * np.abs(np.sin(bend[there]) * out[there])
    with np.errstate(divide="ignore"):
        wrist[there] = np.arcsin(np.minimum(1.0, size / np.maximum(scale, 1e-300)))
    elbow = np.abs(np.arcsin(np.sin(bend)))
    return wrist, elbow, np.arcsin(np.minimum(1.0, np.abs(out) / (form.c2 + forearm)))


def reach_gap(form: OffsetParameters, flange: FloatArray) -> FloatArray:
    """How far (...,) [m] the point where axes 4 and 5 meet, of flange poses (..., 4, 4) in the form's base,
    lies outside what the arm reaches, whatever the wrist does."""
    foot = flange[..., :3, 3] - form.c4 * flange[..., :3, 2]
    distance = np.hypot(np.hypot(foot[..., 0], foot[..., 1]), foot[..., 2] - form.c1)
    forearm, aside = float(np.hypot(form.a2, form.c3)), float(np.hypot(form.a3, form.b3)) + abs(form.a1)
    far = distance - (form.c2 + forearm + aside)
    return np.asarray(np.maximum(np.maximum(far, abs(form.c2 - forearm) - aside - distance), 0.0))


def wrist_gap(form: OffsetParameters, flange: FloatArray) -> FloatArray:
    """How far (...,) [m] the point where axes 4 and 5 meet lies outside what upper arm and forearm reach, at
    flange poses (..., 4, 4) in the form's base, with axis 6 turned to where that is least, of :data:`NODES`
    angles. Where it is 0 and a pose has no solution, the wrist cannot take its direction."""
    angle = np.append(0.0, _FIRST) + 2.0 * np.pi * np.arange(NODES)[:, None] / NODES
    c, s = np.cos(angle.reshape(-1)), np.sin(angle.reshape(-1))
    ex, ey = flange[..., None, :3, 0], flange[..., None, :3, 1]
    foot = flange[..., :3, 3] - form.c4 * flange[..., :3, 2] - np.array([0.0, 0.0, form.c1])
    aside = form.a3 * (c[:, None] * ex - s[:, None] * ey) + form.b3 * (s[:, None] * ex + c[:, None] * ey)
    x, y, up = np.moveaxis(foot[..., None, :] - aside, -1, 0)
    forearm, ahead = float(np.hypot(form.a2, form.c3)), np.hypot(x, y)
    gaps = []
    for out in (ahead - form.a1, -ahead - form.a1):  # before axis 1 and behind it
        far = np.hypot(out, up)
        gaps.append(np.maximum(far - (form.c2 + forearm), abs(form.c2 - forearm) - far).min(axis=-1))
    return np.asarray(np.maximum(np.minimum(*gaps), 0.0))


NEAR: Final = 0.5
"""Joints are followed this far at most [rad]."""
_NEWTON: Final = 12
"""Steps of Newton's method at most."""
_MOST_STEP: Final = 0.2
"""No joint goes farther in one of them [rad]."""
