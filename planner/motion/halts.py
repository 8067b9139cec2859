"""Stops at corners that are so sharp for their small zones that it takes longer to pass them than to stop.

A move has one speed. Where a zone leaves hardly any time to change it, both moves beside the corner would
crawl over all of their length.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.claims import StraightWire
from planner.issues import Issue, Severity
from planner.motion.joints import Dense, JointPath, joint_path
from planner.motion.scene import Scene
from planner.motion.timing import Clock, Limits, settled
from planner.targets import Targets

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

SMALL: Final = 0.1
"""A corner that is rounded over less than this share of a move is sharp."""
CRAWL: Final = 3.0
"""Moves crawl that take so many times as long as their feeds ask for."""
FASTER: Final = 0.8
"""Stops are made where the way takes less than this share of the time then."""
ROUNDS: Final = 3


def clocked(
    scene: Scene,
    targets: Targets,
    samples: Dense,
    limits: Limits,
    rounded: Callable[[FloatArray], FloatArray],
) -> tuple[Targets, JointPath, Clock]:
    """The path and its clock, and the targets with the stops that are worth it. Raises
    :class:`planner.motion.timing.TimingError`."""
    path = joint_path(scene, targets, samples, limits.speed)
    ticks = settled(path, limits, rounded)
    for _ in range(ROUNDS):
        sharp = _sharp(targets, ticks, limits)
        if not sharp.any():
            break
        other = dataclasses.replace(targets, stop=targets.stop | sharp)
        way = joint_path(scene, other, samples, limits.speed)
        again = settled(way, limits, rounded)
        if again.time[-1] > FASTER * ticks.time[-1]:
            break
        targets, path, ticks = other, way, again
    return targets, path, ticks


def _sharp(targets: Targets, ticks: Clock, limits: Limits) -> BoolArray:
    """Sharp corners (N,) between moves that crawl, where one arm alone is at work and may stand still: not
    with a hot wire, nor where a least feed is asked for."""
    out = np.zeros(targets.count, dtype=bool)
    wire = any(isinstance(claim, StraightWire) for claim in targets.claims)
    if wire or targets.coupled or len(targets.arms) > 1:
        return out
    took, least = np.diff(ticks.time, prepend=0.0), limits.least_time
    crawls = took[1:-1] + took[2:] > CRAWL * (least[1:-1] + least[2:])
    stands = (targets.feed_min[1:-1] == 0.0) & (targets.feed_min[2:] == 0.0) & ~targets.stop[1:-1]
    out[1:-1] = crawls & stands & (limits.rounded[1:-1] < SMALL)
    return out


def told(before: Targets, after: Targets) -> list[Issue]:
    """What users are told of stops that ``after`` has more than ``before``."""
    more = np.flatnonzero(after.stop & ~before.stop)
    if not len(more):
        return []
    first = int(more[0])
    what = (
        f"the arm stops at {len(more)} targets, first at {after.name(first)}, where it would have to pass a "
        "sharp corner at less than a third of the feed"
    )
    hint = "round these corners by more targets if it is not to stop there"
    name, count = after.name(first), float(len(more))
    return [Issue("motion.stops", what, Severity.NOTE, index=first, target=name, value=count, hint=hint)]
