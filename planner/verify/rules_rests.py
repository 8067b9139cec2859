"""Rules on what bears a block: the gripper of an arm, or what it stands on."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.catalogue import robot
from planner.geometry.rigid import inverse, transform
from planner.geometry.shapes import corners
from planner.issues import Issue
from planner.problem import Cell, Setup, Stock
from planner.tooling import Gripper
from planner.units import GRAVITY
from planner.verify.context import Context, Outcome, mm

FloatArray = NDArray[np.float64]

SHAKES: Final = 3.0
"""A gripper holds so many times the weight of its block at least."""
FLAT: Final = np.deg2rad(1.0)
GAP: Final = 0.5e-3
"""How far a block's bottom face may be turned and moved off its gripper [rad, m]."""
EDGE: Final = 1e-6
"""How far a gripper's face may stand out of the block's bottom face [m]."""
LEVEL: Final = 1e-5
"""How far the top of what is made for a block may be off a height in stock [m]: decimals of frames."""
FEET: Final = 0.025
"""[m] what feet and shims may be between a support, what it stands on and what it bears."""


def rests(context: Context) -> Outcome:
    """A block that an arm holds lies flat on a gripper whose face is within its own, which holds it firmly
    enough and is with it within the payload; a support bears its block and stands on the floor or on a body
    of the cell, unless the problem accepts that it does not."""
    issues: list[Issue] = []
    told = 0
    for index, setup in enumerate(context.setups):
        stock = setup.stock
        if stock.held_by is not None:
            faults = list(_held(setup))
        elif stock.sheet is None and (stock.support or stock.pedestal):
            place = stock.place if context.places[index] is None else context.places[index]
            skip = place is None or "stock.support" in context.problem.accept
            faults = [] if place is None or skip else list(_stands(setup.cell, stock, place))
        else:
            continue
        told += 1
        issues += [Issue("verify.rests", f"setup {setup.number}: {fault}") for fault in faults]
    return Outcome(tuple(issues), where="" if told else "nothing is held, and no support is stated")


def _held(setup: Setup) -> Iterator[str]:
    stock, arm = setup.stock, setup.cell.arm(str(setup.stock.held_by))
    tool = arm.tool
    if not isinstance(tool, Gripper):
        yield f"{tool.name} of arm {arm.name} holds no block"
        return
    on_block = inverse(stock.grip)  # of the gripper's TCP in the block's frame
    lean = float(np.arccos(np.clip(on_block[2, 2], -1.0, 1.0)))
    gap = float(abs(on_block[2, 3] - stock.lower[2]))
    if lean > FLAT or gap > GAP:
        off = f"{mm(gap):.2f} mm and {np.rad2deg(lean):.2f} deg"
        yield f"the block does not lie flat on {tool.name}, but {off} off it"
    half = 0.5 * np.array(tool.footprint)
    face = np.array([[x, y, 0.0] for x, y in itertools.product((-half[0], half[0]), (-half[1], half[1]))])
    at = transform(on_block, face)[:, :2]
    over = float(np.maximum(stock.lower[:2] - at, at - stock.upper[:2]).max())
    if over > EDGE:
        yield f"the face of {tool.name} stands {mm(over):.2f} mm out of the block's bottom face"
    mass = stock.mass
    if mass is None:
        yield "the block's weight is not known"
        return
    if tool.holding < SHAKES * mass * GRAVITY:
        yield f"{tool.name} holds with {tool.holding:.0f} N, not {SHAKES * mass * GRAVITY:.0f} N"
    if tool.mass + mass > robot(arm.robot).payload:
        payload = robot(arm.robot).payload
        yield f"gripper and block weigh {tool.mass + mass:.2f} kg, the arm carries {payload:g} kg"


def _stands(cell: Cell, stock: Stock, place: FloatArray) -> Iterator[str]:
    """What is wrong with a stated support of a block that stands at ``place`` (4, 4)."""
    under = float(transform(place, _box_corners(stock))[:, 2].min())
    upright = [arm.base[2, 3] for arm in cell.arms if arm.base[2, 2] > 0.5]
    ground = float(min([0.0, *upright]))
    if stock.pedestal is not None:
        off = min(abs(under - ground - height) for height in stock.pedestal.heights)
        if stock.place is None and off > LEVEL:
            kind = stock.pedestal.kind
            yield f"the block is {mm(under - ground):.2f} mm above the floor; no {kind} is that high"
        return
    shapes = [transform(place @ shape.pose, corners(shape)) for shape in stock.support]
    foot = min(float(shape[:, 2].min()) for shape in shapes)
    head = max(float(shape[:, 2].max()) for shape in shapes)
    if under - head > FEET:
        yield f"the block hangs {mm(under - head):.0f} mm above its support"
    lowest = next(shape for shape in shapes if float(shape[:, 2].min()) == foot)
    for obstacle in cell.obstacles:
        for shape in obstacle.shapes:
            body = transform(shape.pose, corners(shape))
            if _beside(lowest[:, :2], body[:, :2]):
                continue
            top = float(body[:, 2].max())
            ground = max(ground, top) if top <= foot + FEET else ground
            ground = foot if body[:, 2].min() <= foot <= top else ground  # it stands in the body
    if foot - ground > FEET:
        yield f"the support ends {mm(foot - ground):.0f} mm above what is below it"


def _beside(one: FloatArray, other: FloatArray) -> bool:
    """Whether the boxes around two sets of points lie beside each other."""
    return bool(((one.min(axis=0) > other.max(axis=0)) | (other.min(axis=0) > one.max(axis=0))).any())


def _box_corners(stock: Stock) -> FloatArray:
    low, high = stock.lower, stock.upper
    return np.array([[x, y, z] for x, y, z in itertools.product(*zip(low, high, strict=True))])
