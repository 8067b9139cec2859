"""Targets with rows picked, repeated or replaced."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from planner.targets import Edge, Freedom, ScrewFreedom, TableFreedom, Targets


def subset(targets: Targets, rows: NDArray[np.intp]) -> Targets:
    """The targets ``rows`` (K,), in that order, for looking at; without actions, claims and exhibits."""
    edge = None if targets.edge is None else Edge(targets.edge.points[rows], targets.edge.radius)
    return dataclasses.replace(
        targets,
        pose={arm: pose[rows] for arm, pose in targets.pose.items()},
        freedoms=tuple(pick(f, rows) for f in targets.freedoms),
        feed=targets.feed[rows],
        feed_min=targets.feed_min[rows],
        travel=targets.travel[rows],
        stop=targets.stop[rows],
        segment=tuple(targets.segment[i] for i in rows),
        edge=edge,
        actions=(),
        claims=(),
        exhibits={},
        issues=(),
    )


def pick(freedom: Freedom, rows: NDArray[np.intp]) -> Freedom:
    """A freedom at the targets ``rows``."""
    prefer = None if freedom.prefer is None else freedom.prefer[rows]
    if isinstance(freedom, TableFreedom):
        pose = {arm: table[rows] for arm, table in freedom.pose.items()}
        return dataclasses.replace(
            freedom, pose=pose, lower=freedom.lower[rows], upper=freedom.upper[rows], prefer=prefer
        )
    if isinstance(freedom, ScrewFreedom):
        return dataclasses.replace(
            freedom, lower=freedom.lower[rows], upper=freedom.upper[rows], prefer=prefer
        )
    raise TypeError(f"unknown freedom {type(freedom).__name__}")
