"""How deep forming tools are in a sheet beyond what is formed already.

Faces are what the sheet is to become: a ball that presses into the middle of a dish, where nothing is
formed yet, cuts into none of them. So what is formed by now is told by the way itself: a place of the
wall is formed once the ball has come as near to it as the steps of the path leave it, or as near as it
ever comes. Loops go down by a step from the highest place that is not formed, all around; off the wall
the sheet is as low as the tip has been. On ways in and out tools go straight.
"""

import itertools
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray, lengths
from planner.processes.forming.claims import FormsSheet
from planner.processes.forming.proof.state import Formed
from planner.processes.forming.proof.swept import walls
from planner.processes.forming.proof.tracks import Track
from planner.proof.faces import areas, divided

Depths = tuple[FloatArray, IntArray]
"""How deep [m] a tool is where nothing lets it be, and at which rows of its track."""

STAYS_WITHIN: Final = 1e-4
"""On its ways in and out a tool in the sheet stays within this [m] of where its segment begins and ends."""
LOOP_FORMS: Final = 0.5
"""Share of a step by which a loop forms the wall below itself."""
MOST_STEPS: Final = 1.5
"""By so many steps the ball may touch the wall below the highest place that is not formed yet: by one, and by
half of one, for places that stand for the wall are some way apart."""
_SPACING: Final = 0.001
"""The ball is looked at whenever it has gone so far [m]."""
_PLACE_SIZE: Final = 0.002
"""Largest size [m] of pieces of the wall that stand for places."""
_PLACES_AT_ONCE: Final = 4096
"""Places of a wall of which is told at once what touches them: lists of it are long."""
_PLACES: Final = 20_000
"""Places of the wall, about, at most."""
_SAME_DISTANCE: Final = 2e-5
"""Distances [m] that differ by less are the same: balls go along chords."""


def on_ways(way: Track, column: int, up: int, level: float, radius: float) -> Depths:
    """How deep one tool is beyond a ``level`` z [m] on its ways in and out where it is not straight above the
    place at which the segment begins or ends, and there how much deeper than that place. ``up`` is +1 for a
    tool above the sheet, whose ball has the ``radius`` [m]."""
    own = np.flatnonzero(way.own)
    deep, rows = [np.zeros(0)], [np.zeros(0, dtype=np.int64)]
    if len(own):
        first, last = int(own[0]), int(own[-1])
        for air, at in ((np.arange(first), max(first - 1, 0)), (np.arange(last + 1, len(way.rows)), last)):
            here, there = way.centre[air, column], way.centre[np.array([at]), column]
            beside = lengths((here - there)[:, :2]) > STAYS_WITHIN
            lowest = np.where(beside, level + up * radius, there[:, 2])
            deep.append(up * (lowest - here[:, 2]))
            rows.append(air)
    return np.concatenate(deep), np.concatenate(rows)


def largest_step(claim: FormsSheet, steps: tuple[float | None, float | None]) -> float:
    """The largest step [m] down a wall in a job of ``steps`` (stepdown, scallop) [m]: ways that leave ridges
    of height h are 2 sqrt(2 R h - h^2) apart along it, and so much times the sine of its angle down it."""
    step, scallop = steps
    if scallop is None:
        return step or 0.0
    corners = claim.vertices[claim.faces[walls(claim)]]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sine = np.hypot(cross[:, 0], cross[:, 1]) / np.maximum(lengths(cross), 1e-30)
    return 2.0 * float(np.sqrt(scallop * (2.0 * claim.radius - scallop)) * sine.max(initial=0.0))


def while_forming(one: Formed, step: float) -> tuple[Depths, Depths]:
    """How deep the forming ball is while it forms, by steps of ``step`` [m] at most: where it touches the
    wall, how far all that it touches is below the highest place that is formed later and `MOST_STEPS`;
    else, how far its tip is below the lowest level it has had where it touched the wall, or has where it does
    so next, no farther than its radius beside that place."""
    claim = one.claim
    points, rows = _points(one)
    if not len(points):
        return (np.zeros(0), rows), (np.zeros(0), rows)
    tip = claim.side * points[:, 2] - claim.radius
    height, formed_at, top = _touched(one, points, step)
    later = np.full(len(points) + 2, -np.inf)
    np.maximum.at(later, formed_at + 1, height)
    later = np.maximum.accumulate(later[::-1])[::-1]
    touches = np.isfinite(top)
    wall = later[2:][touches] - MOST_STEPS * step - top[touches]
    start = claim.side * claim.start - one.begun
    level = np.minimum(np.minimum.accumulate(np.where(touches, tip, np.inf)), start)
    number = np.where(touches, np.arange(len(tip)), len(tip))
    following = np.minimum.accumulate(number[::-1])[::-1]
    known = np.minimum(following, len(tip) - 1)
    near = (following < len(tip)) & (lengths((points[known] - points)[:, :2]) <= claim.radius)
    air = np.where(near, np.minimum(level, tip[known]), level) - tip
    return (wall, rows[touches]), (air[~touches], rows[~touches])


def _points(one: Formed) -> tuple[FloatArray, IntArray]:
    """The ball's centres (N, 3) [m] along its way from its first to its last work, no more than ``_SPACING``
    apart, and the rows (N,) of the track at or behind them."""
    own = np.flatnonzero(one.track.own)
    if not len(own):
        return np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    rows = one.knots[(one.knots >= own[0]) & (one.knots <= own[-1])]
    place = one.track.centre[rows, 0]
    way = np.diff(place, axis=0)
    count = np.maximum(np.ceil(lengths(way) / _SPACING).astype(np.int64), 1)
    which = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)) / count[which]
    points = np.concatenate([place[which] + share[:, None] * way[which], place[-1:]])
    return points, np.append(rows[which + (share > 0.0)], rows[-1])


def _touched(one: Formed, points: FloatArray, step: float) -> tuple[FloatArray, IntArray, FloatArray]:
    """How high (P,) [m] toward the ball places of the wall are, and which (P,) of its ``points`` (N, 3) forms
    each of them, -1 where it is formed before; and how high (N,) the highest place is that it touches at each
    point, minus infinity where it touches none."""
    claim = one.claim
    rows = np.flatnonzero(walls(claim))
    corners = claim.vertices[claim.faces[rows]]
    parts, owner = divided(corners, max(_PLACE_SIZE, 2.0 * float(np.sqrt(areas(corners).sum() / _PLACES))))
    places = parts.mean(axis=1)
    height = claim.side * places[:, 2]
    tree = cKDTree(points)
    bent = _SPACING**2 / (8.0 * claim.radius) + _SAME_DISTANCE
    touched = claim.radius + claim.scallop[rows[owner]] + bent
    # what the ball comes nowhere as near to is formed where it is about as near as ever
    nearest = np.asarray(tree.query(places)[0])
    about = np.maximum(touched, nearest + touched - claim.radius)
    formed_at, top = np.zeros(len(places), dtype=np.int64), np.full(len(points), -np.inf)
    for some in np.array_split(np.arange(len(places)), max(1, len(places) // _PLACES_AT_ONCE)):
        formed = tree.query_ball_point(places[some], about[some], return_sorted=True)
        formed_at[some] = [rows[0] for rows in formed]
        found = tree.query_ball_point(places[some], touched[some], return_sorted=False)
        many = np.array([len(rows) for rows in found])
        index = np.fromiter(itertools.chain.from_iterable(found), np.int64, int(many.sum()))
        np.maximum.at(top, index, np.repeat(height[some], many))
    if one.begun > 0.0:
        formed_at[height >= claim.side * claim.start - one.begun - LOOP_FORMS * step] = -1
    return height, formed_at, top
