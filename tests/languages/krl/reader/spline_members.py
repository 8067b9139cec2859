"""Curves of the family that bounds spline blocks, evaluated one by one.

The evaluation uses the polynomials, not the code that computes the bounds.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import Polynomial
from scipy.spatial.transform import Rotation

from planner.languages.krl.reader.spline_curve import (
    END_FRACTION,
    MAX_BEND_WEIGHT,
    OUTER_FRACTION,
    ROTATION_LEVER_M_PER_RAD,
)

RULES = ("even", "chord", "centripetal", "time", "any")
KINDS = ("random", "extreme", "catmull-rom", "five points", "akima", "minimum jerk", "flat")


def rows(pose, i):
    """Steps (6,) of all segments of a block as segment i sees them, and the points (N + 1, 6)."""
    turn = (Rotation.from_matrix(pose[i, :3, :3]).inv() * Rotation.from_matrix(pose[:, :3, :3])).as_rotvec()
    points = np.concatenate([pose[:, :3, 3] - pose[i, :3, 3], ROTATION_LEVER_M_PER_RAD * turn], axis=1)
    return np.diff(points, axis=0), points


def knots(rule, steps, times, rng):
    """Knot intervals (N,) by a rule; "any" is anywhere between even and chord, segment by segment."""
    way = np.linalg.norm(steps, axis=1)
    return {"even": np.ones(len(way)), "chord": way, "centripetal": np.sqrt(way), "time": times, "any": None}[
        rule
    ]


def intervals(rule, i, steps, times, rng):
    """g_k / g_i (N,) of the member at segment i."""
    way = np.linalg.norm(steps, axis=1)
    if rule != "any":
        own = knots(rule, steps, times, rng)
        return own / own[i]
    low, high = np.minimum(1.0, way / way[i]), np.maximum(1.0, way / way[i])
    fraction = rng.choice([0.0, 1.0, rng.random()], len(way))
    # reciprocals are what counts
    return 1.0 / (fraction / low + (1.0 - fraction) / high)


def slope(k, steps, gap, kind, rng):
    """V (6,) at point k of a member: between the slopes beside it and off that by the outer changes."""
    count = len(steps)
    d = steps / gap[:, None]

    def change(j):
        return d[j] - d[j - 1] if 1 <= j < count else np.zeros(6)

    if k in (0, count):
        inner, near = (d[0], change(1)) if k == 0 else (d[-1], change(count - 1))
        scale = {
            "random": rng.uniform(-END_FRACTION, END_FRACTION),
            "extreme": rng.choice([-END_FRACTION, END_FRACTION]),
        }
        half = -0.5 if k == 0 else 0.5
        return inner + scale.get(kind, half) * near
    before, after = d[k - 1], d[k]
    # the changes that a point beside an end has beyond it are none
    outer = change(k - 1), change(k + 1)
    if kind == "random":
        fraction, (a, b) = rng.random(), rng.uniform(-OUTER_FRACTION, OUTER_FRACTION, 2)
    elif kind == "extreme":
        fraction, (a, b) = rng.choice([0.0, 1.0]), rng.choice([-OUTER_FRACTION, OUTER_FRACTION], 2)
    elif kind == "five points":
        fraction, a, b = 0.5, 1.0 / 12.0, -1.0 / 12.0
    elif kind == "minimum jerk":
        fraction, a, b = 0.5, 0.1033, -0.1033
    elif kind == "akima":
        one, two = np.linalg.norm(outer[1]), np.linalg.norm(outer[0])
        fraction, a, b = (0.5 if one + two == 0.0 else two / (one + two)), 0.0, 0.0
    else:
        fraction, a, b = gap[k - 1] / (gap[k - 1] + gap[k]), 0.0, 0.0
    return (1.0 - fraction) * before + fraction * after + a * outer[0] + b * outer[1]


def bend(k, steps, gap, kind, rng):
    """A (6,) at point k of a member."""
    count = len(steps)
    d = steps / gap[:, None]

    def change(j):
        if not 1 <= j < count:
            return np.zeros(6)
        return (d[j] - d[j - 1]) * 2.0 / (gap[j - 1] + gap[j])

    three = np.array([change(k - 1), change(k), change(k + 1)])
    if kind == "random":
        weights = rng.dirichlet(np.ones(3)) * MAX_BEND_WEIGHT * rng.random() * rng.choice([-1, 1], 3)
    elif kind == "extreme":
        weights = MAX_BEND_WEIGHT * rng.choice([-1, 1]) * np.eye(3)[rng.integers(3)]
    else:
        weights = {
            "five points": np.array([-1.0, 14.0, -1.0]) / 12.0,
            "minimum jerk": np.array([-0.175, 1.35, -0.175]),
            "flat": np.zeros(3),
        }.get(kind, np.array([0.0, 1.0, 0.0]))
    if k in (0, count):
        weights = weights / MAX_BEND_WEIGHT
    return weights @ three


def member(i, pose, times, rule, kind, rng):
    """Segment i of a member as polynomials of u, one for each of six numbers."""
    steps, _ = rows(pose, i)
    gap = intervals(rule, i, steps, times, rng)
    own = steps[i]
    first, last = slope(i, steps, gap, kind, rng), slope(i + 1, steps, gap, kind, rng)
    one, two = bend(i, steps, gap, kind, rng), bend(i + 1, steps, gap, kind, rng)
    for at, (v, a) in ((0, (first, one)), (len(steps), (last, two))):
        if at == i + (at > 0):  # the arm stands there: a share of both, none where times are looked at
            fraction = 0.0 if rule == "time" else rng.choice([0.0, 1.0, rng.random()])
            v *= fraction
            a *= fraction
    # six conditions at the two ends: x, x', x''
    rows_ = [
        [float(np.polynomial.polynomial.polyval(u, Polynomial.basis(p).deriv(k).coef)) for p in range(6)]
        for u in (0.0, 1.0)
        for k in range(3)
    ]
    expected = np.array([np.zeros(6), first, one, own, last, two])
    return [Polynomial(column) for column in np.linalg.solve(np.array(rows_), expected).T], own


def max_deviation(curve, steps, i, count=200):
    """How far a member of segment i is off the straight ways at most, its own and those beside it: in all six
    numbers, by place, by turn [m, turns by TURN_LEVER]; and its highest rates: of all, and of the TCP."""
    u = np.linspace(0.0, 1.0, count)
    own = steps[i]
    x = np.stack([p(u) for p in curve], axis=1)
    rate = np.stack([p.deriv()(u) for p in curve], axis=1)
    ways = [(np.zeros(6), own)]
    if i:
        ways.append((-steps[i - 1], steps[i - 1]))
    if i + 1 < len(steps):
        ways.append((own, steps[i + 1]))
    apart = []
    for start, way in ways:
        fraction = np.clip((x - start) @ way / (way @ way), 0.0, 1.0)
        apart.append(x - start - fraction[:, None] * way)
    apart = np.array(apart)
    best = np.linalg.norm(apart, axis=2).argmin(axis=0)
    near = apart[best, np.arange(count)]
    return (
        np.linalg.norm(near, axis=1).max(),
        np.linalg.norm(rate - own, axis=1).max(),
        np.linalg.norm(rate[:, :3], axis=1).max(),
    )


def block(rng, count, kind):
    """Poses (N + 1, 4, 4) and times (N,) of a block: smooth, with a kink, or anyhow."""
    pose = np.tile(np.eye(4), (count + 1, 1, 1))
    if kind == "anyhow":
        place = np.cumsum(rng.normal(0.0, 2e-3, (count + 1, 3)), axis=0)
        turn = np.cumsum(rng.normal(0.0, 0.02, (count + 1, 3)), axis=0)
    else:
        step = 2e-3 * (1.0 + 0.5 * rng.random(count + 1))
        along = np.cumsum(step)
        radius = 0.05 if kind == "arc" else 1e3
        place = radius * np.stack([np.sin(along / radius), 1.0 - np.cos(along / radius), 0 * along], axis=1)
        turn = np.outer(along, rng.normal(0.0, 3.0, 3))
        if kind == "kink":
            half = count // 2
            place[half + 1 :, 1] += along[half + 1 :] - along[half]
    pose[:, :3, 3] = place
    pose[:, :3, :3] = Rotation.from_rotvec(turn).as_matrix()
    times = np.linalg.norm(np.diff(place, axis=0), axis=1) / 0.03 * rng.uniform(0.8, 1.5, count)
    return pose, times
