"""Where the block and a straight wire are at joint angles, in the setup of an operation."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from planner import catalogue
from planner.cell.robots import forward
from planner.geometry.rigid import inverse
from planner.geometry.shapes import Shape, axis_ends
from planner.problem import Arm, Problem, Setup
from planner.tooling import Bow, Mill

FloatArray = NDArray[np.float64]


def flanges(arm: Arm, bases: Mapping[str, FloatArray], q: FloatArray) -> FloatArray:
    """Flange poses (..., 4, 4) in the world at joint angles q (..., 6); ``bases`` replaces the arm's own."""
    base = np.asarray(bases.get(arm.name, arm.base))
    return np.asarray(base @ forward(catalogue.robot(arm.robot), q))


def block(
    setup: Setup, place: FloatArray, bases: Mapping[str, FloatArray], q: Mapping[str, FloatArray]
) -> FloatArray:
    """The stock's poses in the world: (4, 4) of a standing block, (T, 4, 4) of one that an arm holds, at the
    joint angles {arm: (T, 6)}; an arm that is not named stays at home."""
    holder = setup.stock.held_by
    if holder is None:
        return np.asarray(place, dtype=np.float64)
    arm = setup.cell.arm(holder)
    return np.asarray(flanges(arm, bases, q.get(holder, arm.home)) @ arm.tool.tcp @ setup.stock.grip)


def cutter(setup: Setup, arms: tuple[str, ...]) -> Arm | None:
    """The first of these arms whose tool cuts along a line, or None: a bow along its wire, a mill along its
    axis."""
    carriers = (setup.cell.arm(name) for name in arms)
    return next((arm for arm in carriers if isinstance(arm.tool, Bow | Mill)), None)


def wire_in_block(
    setup: Setup,
    arm: Arm,
    place: FloatArray,
    bases: Mapping[str, FloatArray],
    q: Mapping[str, FloatArray],
) -> FloatArray:
    """Both ends (T, 2, 3) [m] of a straight wire, or of a cutter's axis, in the stock frame at joint angles
    {arm: (T, 6)}."""
    pose = inverse(block(setup, place, bases, q)) @ flanges(arm, bases, q[arm.name])
    return np.asarray(np.einsum("tij,kj->tki", pose[:, :3, :3], ends(arm)) + pose[:, None, :3, 3])


def ends(arm: Arm) -> FloatArray:
    """Both ends (2, 3) [m] of a straight wire, or of a cutter's axis, in the flange frame; ``ValueError`` for
    tools without either."""
    match arm.tool:
        case Bow():
            return axis_ends(arm.tool.wire)
        case Mill():
            return axis_ends(arm.tool.solid)
        case _:
            raise ValueError(f"tool {arm.tool.name} cuts along no line")


def box(setup: Setup) -> Shape:
    """The block as found, in the stock frame."""
    lower, upper = setup.stock.lower, setup.stock.upper
    pose = np.eye(4)
    pose[:3, 3] = 0.5 * (lower + upper)
    size = upper - lower
    return Shape("box", (float(size[0]), float(size[1]), float(size[2])), pose)


def setup_index(problem: Problem, operation: int) -> int:
    """Place of an operation's setup among the problem's setups, from 0."""
    return problem.setup_of(operation).number - 1
