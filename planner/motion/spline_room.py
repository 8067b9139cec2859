"""The room that a plan leaves for spline blocks (``controller: {path: spline}``): the curve between two
targets is known within bounds only, and the proof takes these off."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.claims import FeedWindow
from planner.problem import Problem
from planner.targets import Targets

CLEARANCE: Final = 4e-3
"""Bodies keep so much farther [m] apart."""
MARGIN: Final = float(np.deg2rad(0.2))
"""Axes keep so much farther [rad] off their limits and off singular postures."""
SLOWER: Final = 1.15
"""Tools go so many times as slow as allowed: they may be faster between two targets."""
NEAR_STOPS: Final = 1.25
"""The same of the first two and the last two moves from stop to stop, besides: ramps end faster."""


def with_room(problem: Problem, targets: Sequence[Targets]) -> tuple[Problem, tuple[Targets, ...]]:
    """The problem and its targets with room for the curves of spline blocks; as they are without such."""
    if problem.cell.controller.path != "spline":
        return problem, tuple(targets)
    own = problem.settings
    settings = dataclasses.replace(
        own,
        clearance=own.clearance + CLEARANCE,
        joint_margin=own.joint_margin + MARGIN,
        singularity_margin=own.singularity_margin + MARGIN,
        tcp_speed=own.tcp_speed / SLOWER,
    )
    slower = tuple(
        dataclasses.replace(t, feed=t.feed / np.where(_near_stops(t), SLOWER * NEAR_STOPS, SLOWER))
        if any(isinstance(claim, FeedWindow) for claim in t.claims)
        else t
        for t in targets
    )
    return dataclasses.replace(problem, settings=settings), slower


def _near_stops(targets: Targets) -> NDArray[np.bool_]:
    """Moves to targets (N,) that are one of two before or behind a stop."""
    stop = targets.stop.copy()
    stop[[0, -1]] = True
    out = stop.copy()
    out[:-1] |= stop[1:]
    for k in (1, 2):
        out[k:] |= stop[:-k]
    return out
