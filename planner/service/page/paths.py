"""What the page draws of poses that a table gives: the ways of the tool points, as thin bars."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner import processes
from planner.issues import Issue, TandemError
from planner.problem import Mesh, Problem

PROCESS: Final = "targets"
"""Its targets are as good as read from a file; those of other processes take planning."""
MOST: Final = 3000
"""Bars of one way; of longer ones some poses are left out."""
WIDTH: Final = 0.004
"""Of a bar, as a share of the way's extent and the block's."""
FloatArray = NDArray[np.float64]


def paths(problem: Problem) -> tuple[list[tuple[str, Mesh]], list[Issue]]:
    """The ways by name, in the stock's frame [m], and what is wrong with their tables."""
    found: list[tuple[str, Mesh]] = []
    faults: list[Issue] = []
    for index, operation in enumerate(problem.operations):
        if operation.process != PROCESS:
            continue
        try:
            targets = processes.job(problem, index).targets()
        except TandemError as error:
            faults.extend(error.issues)
            continue
        stock = problem.setup_of(index).stock
        for arm in targets.arms:
            places = targets.pose[arm][:, :3, 3]
            if targets.frame[arm] == "world":
                if stock.place is None:  # the search will say where the block is
                    continue
                places = (places - stock.place[:3, 3]) @ stock.place[:3, :3]
            size = max(float(np.ptp(places, axis=0).max()), float(stock.size.max()))
            found.append((f"{operation.name}, {arm}", bars(places, WIDTH * size)))
    return found, faults


def bars(places: FloatArray, width: float) -> Mesh:
    """Bars of a square section from each place (N, 3) to the next one; equal places have none."""
    some = places[np.unique(np.linspace(0, len(places) - 1, MOST + 1).round().astype(int))]
    start, way = some[:-1], np.diff(some, axis=0)
    length = np.linalg.norm(way, axis=1)
    start, way, length = start[length > 0.0], way[length > 0.0], length[length > 0.0]
    along = way / length[:, None]
    other = np.eye(3)[np.argmin(np.abs(along), axis=1)]
    across = np.cross(along, other)
    across *= 0.5 * width / np.linalg.norm(across, axis=1)[:, None]
    up = np.cross(along, across)
    ring = np.stack([across + up, up - across, -across - up, across - up], axis=1)
    corners = np.concatenate([start[:, None] + ring, (start + way)[:, None] + ring], axis=1)
    sides = [(i, (i + 1) % 4, 4 + i) for i in range(4)]
    sides += [((i + 1) % 4, 4 + (i + 1) % 4, 4 + i) for i in range(4)]
    caps = [(0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7)]
    faces = np.array(sides + caps)[None] + 8 * np.arange(len(start))[:, None, None]
    return Mesh(corners.reshape(-1, 3), faces.reshape(-1, 3))
