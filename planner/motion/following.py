"""The law by which a track goes along while its arm works: e = clip(k p.d + c, limits).

p.d is how far the tool is along the track, k the share of it that the track goes along, c an offset that is
chosen. Where that has corners, at the ends of the range and where the tool turns back, it is smoothed over
the tool's way; what is left of them the clock has as it has those of joints.
"""

import dataclasses
from collections.abc import Callable, Collection
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, lengths, spread_rows
from planner.geometry.units import MM
from planner.motion.place_margin import margin
from planner.motion.planning_scene import Scene
from planner.motion.search.path_search import with_aims
from planner.motion.search.subsampling import few_of
from planner.problem import OUTER_DECIMALS, Cell, LinearAxis
from planner.targets import Targets

SMOOTHED_M: Final = 0.1
"""A value is the mean of those on so much [m] of the tool's way before and behind, the nearer the more."""
GRID_M: Final = 5e-3
"""Steps [m] of the tool's way by which it is smoothed,"""
MOST_STEPS: Final = 200_000
"""at most so many."""
SLID_SHARES: Final = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Shares of the range of a freedom at which it is asked how far it slides a tool."""
MOST_SLIDE_M: Final = 5e-3
"""A tool may slide so far [m] along a track that goes along by its nominal poses."""
STEP_M: Final = 0.1
"""Offsets are so far apart [m],"""
MOST_OFFSETS: Final = 201
"""at most so many."""
FEW_TARGETS: Final = 24
"""Targets at which they are judged."""
MOST_TRIED: Final = 8
"""Offsets for which a path is searched at most,"""
APART_M: Final = 0.2
"""so far [m] apart."""


@dataclasses.dataclass(frozen=True)
class Unreached:
    """No law does: the values (N,) [m] of the ``best`` one, how many were ``tried``, and why the first was in
    vain."""

    best: FloatArray
    tried: int
    fault: str


def chosen(
    scene: Scene,
    cell: Cell,
    targets: Targets,
    arm: str,
    judged: Collection[str],
    fault: Callable[[Targets], str],
) -> FloatArray | Unreached:
    """The values (N,) [m] of the track of an arm by the law whose offset leaves joints of the arms ``judged``
    most room at a few targets, of those of which ``fault`` says nothing for targets that ride so."""
    track, share = scene.tracks[arm][0], scene.tracks[arm][0].follow or 0.0
    place, gone = along(scene, targets, arm)
    grid = offsets(track, share, place)
    laws = np.stack([law(track, share, place, gone, offset) for offset in grid])
    few, rows = (
        few_of(cell, with_aims(scene, targets), FEW_TARGETS, False),
        spread_rows(len(place), FEW_TARGETS),
    )
    riding = [dataclasses.replace(few.targets, ride={arm: values[rows]}) for values in laws]
    ridden = [dataclasses.replace(few, targets=own) for own in riding]
    score = np.array([margin(own, scene.stock[None, None], {}, scene.settings, judged)[0] for own in ridden])
    tried: list[float] = []
    first = ""
    for k in np.argsort(-score, kind="stable").tolist():
        near = any(abs(grid[k] - other) < APART_M for other in tried)
        if near or len(tried) >= MOST_TRIED or not score[k] > 0.0:
            continue
        tried.append(float(grid[k]))
        found = fault(dataclasses.replace(targets, ride={arm: laws[k]}))
        if not found:
            return np.asarray(laws[k])
        first = first or found
    return Unreached(laws[int(np.argmax(score))], len(tried), first)


def along(scene: Scene, targets: Targets, arm: str) -> tuple[FloatArray, FloatArray]:
    """Of nominal targets how far (N,) [m] the tool is along the track of an arm from the world's origin, and
    how far (N,) [m] it has gone since the first."""
    track, _ = scene.tracks[arm]
    place = scene.world(targets, {arm: targets.pose[arm] for arm in targets.arms})[arm][:, :3, 3]
    gone = np.append(0.0, np.cumsum(lengths(np.diff(place, axis=0))))
    return place @ track.axis, gone


def law(track: LinearAxis, share: float, place: FloatArray, gone: FloatArray, offset: float) -> FloatArray:
    """Values (N,) [m] of a track at targets whose tool is at ``place`` (N,) [m] along it and has ``gone``
    (N,) [m]; ``offset`` [m] is the c of the law. No move takes the track farther than the tool, so zones that
    suit the tool suit the track."""
    exact = np.clip(share * place + offset, track.low, track.high)
    steps = int(min(max(np.ceil(gone[-1] / GRID_M), 1.0), MOST_STEPS))
    grid = np.linspace(0.0, max(float(gone[-1]), GRID_M), steps + 1)
    width = max(round(SMOOTHED_M / float(grid[1] - grid[0])), 1)
    order = np.append(True, np.diff(gone) > 0.0)  # of places that the tool only turns at, the first
    even = np.interp(grid, gone[order], exact[order])
    box = np.full(width, 1.0 / width)
    weights = np.convolve(box, box)
    padded = np.pad(even, width - 1, mode="edge")
    smooth = np.interp(gone, grid, np.convolve(padded, weights, mode="valid"))
    written = np.round(smooth / MM, OUTER_DECIMALS) * MM
    return np.asarray(np.clip(written, track.low, track.high))


def slides(scene: Scene, targets: Targets, arm: str) -> float:
    """How far [m] the freedoms of targets move the tool along the track at most, each by itself."""
    track, _ = scene.tracks[arm]
    bare, worst = dataclasses.replace(targets, ride={}), 0.0
    neutral = bare.neutral()
    at = scene.tcp(bare, neutral)[arm][:, :3, 3] @ track.axis
    for j, freedom in enumerate(bare.freedoms):
        for share in SLID_SHARES:
            values = neutral.copy()
            values[:, j] = freedom.lower + share * (freedom.upper - freedom.lower)
            there = scene.tcp(bare, values)[arm][:, :3, 3] @ track.axis
            worst = max(worst, float(np.abs(there - at).max()))
    return worst


def offsets(track: LinearAxis, share: float, place: FloatArray) -> FloatArray:
    """Offsets (K,) [m] with which the law is within the track's range somewhere, for a tool that is at
    ``place`` (N,) [m] along it."""
    low, high = track.low - share * float(place.max()), track.high - share * float(place.min())
    count = min(max(int(np.ceil((high - low) / STEP_M)) + 1, 2), MOST_OFFSETS)
    return np.asarray(np.round(np.linspace(low, high, count), 4))
