"""verify.rests: what bears a block, the gripper of an arm or what it stands on."""

import itertools
from collections.abc import Iterator
from typing import Final

import numpy as np
import shapely
from scipy.spatial import ConvexHull

from planner.cell import support
from planner.geometry.arrays import FloatArray, corners, inverse, transform
from planner.geometry.units import GRAVITY
from planner.issues import Issue
from planner.problem import Cell, Pedestal, Setup, Stock
from planner.proof.context import Context
from planner.proof.kinematics.external_axes import floor_of
from planner.proof.rule import Outcome, mm, rule
from planner.tooling import Gripper

GRIP_FACTOR: Final = 3.0
"""A gripper holds so many times the weight of its block at least."""
GRIPPER_TILT: Final = np.deg2rad(1.0)
"""How far a block's bottom face may be turned off its gripper [rad]."""
GRIPPER_GAP: Final = 0.5e-3
"""How far a block's bottom face may be off its gripper [m]."""
GRIPPER_OVERHANG: Final = 1e-6
"""How far a gripper's face may stand out of the block's bottom face [m]."""
TOP_HEIGHT_ERROR: Final = 1e-5
"""How far the top of what is made for a block may be off a height in stock [m]: decimals of frames."""
FEET_HEIGHT: Final = 0.025
"""[m] what feet and shims may be between a support, what it stands on and what it bears."""


@rule("verify.rests")
def rests(context: Context) -> Outcome:
    """A block that an arm holds lies flat on a gripper whose face is within its own, which holds it firmly
    enough and is with it within the payload; any other one stands on the floor, on a body of the cell or on
    a support that is under its middle and stands there itself, with a positioner's tilt at 0, unless the
    problem accepts that it does not. What is made for a block is of sizes in stock and in no body of the
    cell, whatever is accepted."""
    issues: list[Issue] = []
    told = 0
    for index, setup in enumerate(context.setups):
        stock = setup.stock
        if stock.held_by is not None:
            faults = list(_held(setup))
        elif stock.sheet is None:
            place = stock.place if context.places[index] is None else context.places[index]
            stated = bool(stock.support) or stock.pedestal is not None
            taken = ("stock.support" if stated else "stock.hangs") in context.problem.accept
            table = setup.cell.turntable
            if table is not None and table.tilt is not None and place is not None:
                place = table.tilt.turned(place, -(stock.tilt or 0.0))
            faults = [] if place is None else list(_stands(setup.upright.cell, stock, place, taken))
        else:
            continue
        told += 1
        issues += [Issue("verify.rests", f"setup {setup.number}: {fault}") for fault in faults]
    return Outcome(tuple(issues), nothing="" if told else "only sheets")


def _held(setup: Setup) -> Iterator[str]:
    stock, arm = setup.stock, setup.cell.arm(str(setup.stock.held_by))
    tool = arm.tool
    if not isinstance(tool, Gripper):
        yield f"{tool.name} of arm {arm.name} holds no block"
        return
    on_block = inverse(stock.grip)  # of the gripper's TCP in the block's frame
    lean = float(np.arccos(np.clip(on_block[2, 2], -1.0, 1.0)))
    gap = float(abs(on_block[2, 3] - stock.lower[2]))
    if lean > GRIPPER_TILT or gap > GRIPPER_GAP:
        off = f"{mm(gap):.2f} mm and {np.rad2deg(lean):.2f} deg"
        yield f"the block does not lie flat on {tool.name}, but {off} off it"
    half = 0.5 * np.array(tool.footprint)
    face = np.array([[x, y, 0.0] for x, y in itertools.product((-half[0], half[0]), (-half[1], half[1]))])
    at = transform(on_block, face)[:, :2]
    over = float(np.maximum(stock.lower[:2] - at, at - stock.upper[:2]).max())
    if over > GRIPPER_OVERHANG:
        yield f"the face of {tool.name} stands {mm(over):.2f} mm out of the block's bottom face"
    mass = stock.mass
    if mass is None:
        yield "the block's weight is not known"
        return
    if tool.holding < GRIP_FACTOR * mass * GRAVITY:
        yield f"{tool.name} holds with {tool.holding:.0f} N, not {GRIP_FACTOR * mass * GRAVITY:.0f} N"
    if tool.mass + mass > arm.data.payload:
        payload = arm.data.payload
        yield f"gripper and block weigh {tool.mass + mass:.2f} kg, the arm carries {payload:g} kg"


def _stands(cell: Cell, stock: Stock, place: FloatArray, taken: bool) -> Iterator[str]:
    """What is wrong with how a block stands at ``place`` (4, 4); ``taken``: the problem accepts that it
    stands as it is stated to."""
    block = transform(place, _box_corners(stock))
    under = float(block[:, 2].min())
    floor = floor_of(cell)
    bodies = [transform(s.pose, corners(s)) for obstacle in cell.obstacles for s in obstacle.shapes]
    if stock.pedestal is not None:
        yield from _made(stock, stock.pedestal, place, under - floor, taken)
        if under - floor <= FEET_HEIGHT:
            return
    elif under < floor - FEET_HEIGHT - GRIPPER_OVERHANG and not taken:
        yield f"the block goes {mm(floor - under):.0f} mm below the floor"
    shapes = support.with_support(cell, stock, place).support
    feet = [transform(place @ shape.pose, corners(shape)) for shape in shapes]
    if stock.pedestal is None and taken:
        return
    if stock.pedestal is None and not stock.support:
        air = under - _ground(block, floor, bodies)
        if air > FEET_HEIGHT + GRIPPER_OVERHANG:
            yield f"the block hangs {mm(air):.0f} mm above what would bear it; no support is stated"
        return
    yield from _on(block, feet)
    if not feet:
        return
    if stock.pedestal is not None and not (taken and stock.place is not None):
        yield from _stands_in(feet[0], cell)
    lowest = min(feet, key=lambda one: float(one[:, 2].min()))
    air = float(lowest[:, 2].min()) - _ground(lowest, floor, bodies)
    if air > FEET_HEIGHT + GRIPPER_OVERHANG:
        yield f"the support ends {mm(air):.0f} mm above what is below it"
    if stock.pedestal is not None:
        sides = [
            v for v, up in zip(shapes[0].size, (place @ shapes[0].pose)[2], strict=False) if abs(up) < 0.5
        ]
        if any(min(abs(v - side) for side in stock.pedestal.sides) > TOP_HEIGHT_ERROR for v in sides):
            size = " x ".join(f"{mm(v):.0f}" for v in sides)
            yield f"no {stock.pedestal.kind} of {size} mm is in stock"


def _made(stock: Stock, pedestal: Pedestal, place: FloatArray, high: float, taken: bool) -> Iterator[str]:
    """What is wrong with a block for which something ``high`` [m] is made to stand on."""
    kind, heights = pedestal.kind, pedestal.heights
    if float(np.abs(place[2, :3]).max()) < np.cos(GRIPPER_TILT):
        yield f"the block leans, and stands on no {kind}"
    if stock.place is None:
        if min(abs(high - one) for one in heights) > TOP_HEIGHT_ERROR:
            yield f"the block is {mm(high):.2f} mm above the floor; no {kind} is that high"
    elif (high > max(heights) + TOP_HEIGHT_ERROR or high < -FEET_HEIGHT - GRIPPER_OVERHANG) and not taken:
        most = mm(max(heights))
        yield f"the block is {mm(high):.0f} mm above the floor; a {kind} is up to {most:.0f} mm high"


def _stands_in(made: FloatArray, cell: Cell) -> Iterator[str]:
    """Bodies of the cell that would be inside of what is made for a block, by its corners (8, 3)."""
    low, high = made[:, 2].min(), made[:, 2].max()
    view = shapely.MultiPoint(made[:, :2]).convex_hull
    for obstacle in cell.obstacles:
        for shape in obstacle.shapes:
            body = transform(shape.pose, corners(shape))
            deep = min(float(body[:, 2].max() - low), float(high - body[:, 2].min()))
            shared = shapely.MultiPoint(body[:, :2]).convex_hull & view
            if deep > FEET_HEIGHT and shared.area > GRIPPER_OVERHANG:
                yield f"{obstacle.name} of the cell is inside of what is made for the block to stand on"
                return


def _on(block: FloatArray, shapes: list[FloatArray]) -> Iterator[str]:
    """What is wrong with how a block, by its corners (8, 3), stands on shapes, by theirs."""
    under, seen = float(block[:, 2].min()), ConvexHull(block[:, :2])
    outline = shapely.Polygon(block[seen.vertices, :2])
    parts = [
        shapely.MultiPoint(one[:, :2]).convex_hull & outline for one in shapes if one[:, 2].min() < under
    ]
    heads = [float(one[:, 2].max()) for one in shapes if one[:, 2].min() < under]
    found = [(head, part) for head, part in zip(heads, parts, strict=True) if part.area > 0.0]
    if not found:
        yield "nothing of its support is under the block"
        return
    head = max(one for one, _ in found)
    if under - head > FEET_HEIGHT + GRIPPER_OVERHANG:
        yield f"the block hangs {mm(under - head):.0f} mm above its support"
    bearing = shapely.GeometryCollection(
        [part for one, part in found if one >= head - FEET_HEIGHT - GRIPPER_OVERHANG]
    )
    aside = float(bearing.convex_hull.distance(shapely.Point(outline.centroid)))
    if aside > GRIPPER_OVERHANG:
        yield f"the middle of the block is {mm(aside):.0f} mm beside its support"


def _ground(body: FloatArray, floor: float, bodies: list[FloatArray]) -> float:
    """Height [m] of what bears a body, by corners of both: a box at a corner alone bears nothing, several of
    one height do where the middle of the body is between them."""
    low, high = body.min(axis=0), body.max(axis=0)
    middle = 0.5 * (low + high)[:2]
    beneath = [
        one
        for one in bodies
        if one[:, 2].min() <= low[2] + FEET_HEIGHT and not _beside(body[:, :2], one[:, :2])
    ]
    best = floor
    for one in beneath:
        top = float(one[:, 2].max())
        level = [
            other
            for other in beneath
            if abs(float(other[:, 2].max()) - top) <= FEET_HEIGHT + GRIPPER_OVERHANG
        ]
        first = np.min([np.maximum(low, other.min(axis=0))[:2] for other in level], axis=0)
        last = np.max([np.minimum(high, other.max(axis=0))[:2] for other in level], axis=0)
        if ((first <= middle + GRIPPER_OVERHANG) & (middle <= last + GRIPPER_OVERHANG)).all():
            best = max(best, min(top, float(low[2])))  # it may stand in the body
    return best


def _beside(one: FloatArray, other: FloatArray) -> bool:
    """Whether the boxes around two sets of points lie beside each other."""
    return bool(((one.min(axis=0) > other.max(axis=0)) | (other.min(axis=0) > one.max(axis=0))).any())


def _box_corners(stock: Stock) -> FloatArray:
    low, high = stock.lower, stock.upper
    return np.array([[x, y, z] for x, y, z in itertools.product(*zip(low, high, strict=True))])
