"""verify.rests: how a block is held by a gripper or supported."""

import itertools
from collections.abc import Iterator
from typing import Final

import numpy as np
import shapely
from scipy.spatial import ConvexHull

from planner.cell import support
from planner.geometry.arrays import FloatArray, hull_points, inverse, transform
from planner.geometry.units import GRAVITY
from planner.issues import Issue
from planner.problem import Cell, Pedestal, Setup, Stock
from planner.proof.context import Context
from planner.proof.kinematics.external_axes import floor_height
from planner.proof.rule import RuleOutcome, mm, rule
from planner.tooling import Gripper

MIN_GRIP_FORCE_FACTOR: Final = 3.0
"""Minimum ratio of a gripper's holding force to the weight of its block."""
MAX_GRIPPER_TILT_RAD: Final = np.deg2rad(1.0)
"""Maximum angle [rad] between the bottom face of a block and its gripper."""
MAX_GRIPPER_GAP_M: Final = 0.5e-3
"""Maximum distance [m] between the bottom face of a block and its gripper."""
MAX_GRIPPER_OVERHANG_M: Final = 1e-6
"""Maximum overhang [m] of a gripper's face over the bottom face of the block."""
TOP_HEIGHT_TOLERANCE_M: Final = 1e-5
"""Tolerance [m] between the top of a pedestal and a height in stock, from the decimals of frames."""
MAX_FEET_HEIGHT_M: Final = 0.025
"""Height [m] that feet and shims may take between a support and the body above or below it."""


@rule("verify.rests")
def block_support(context: Context) -> RuleOutcome:
    """A block is held by a gripper or supported as required.
    A held block lies flat on a gripper whose face is within the block's bottom face, whose holding force
    suffices, and whose mass with the block is within the payload. Any other block stands on the floor,
    on a body of the cell, or on a support that is under its centre and stands itself, with a
    positioner's tilt at 0, unless the problem accepts otherwise. Pedestals have sizes in stock and
    intersect no body of the cell, whatever is accepted.
    """
    issues: list[Issue] = []
    checked_count = 0
    for index, setup in enumerate(context.setups):
        stock = setup.stock
        if stock.held_by is not None:
            faults = list(_check_held(setup))
        elif stock.sheet is None:
            # The pose of the text counts, else that of the problem, with a positioner's tilt rotated back.
            stock_pose = stock.place if context.stock_frames[index] is None else context.stock_frames[index]
            has_support = bool(stock.support) or stock.pedestal is not None
            accepted = ("stock.support" if has_support else "stock.hangs") in context.problem.accept
            table = setup.cell.turntable
            if table is not None and table.tilt is not None and stock_pose is not None:
                stock_pose = table.tilt.rotate(stock_pose, -(stock.tilt or 0.0))
            faults = (
                []
                if stock_pose is None
                else list(_check_support(setup.with_zero_tilt.cell, stock, stock_pose, accepted))
            )
        else:
            continue
        checked_count += 1
        issues += [Issue("verify.rests", f"setup {setup.number}: {fault}") for fault in faults]
    return RuleOutcome(tuple(issues), nothing="" if checked_count else "only sheets")


def _check_held(setup: Setup) -> Iterator[str]:
    """Check a block that an arm holds with a gripper, and yield the faults as texts."""
    stock, arm = setup.stock, setup.cell.arm(str(setup.stock.held_by))
    tool = arm.tool
    if not isinstance(tool, Gripper):
        yield f"{tool.name} of arm {arm.name} cannot hold a block"
        return
    on_block = inverse(stock.grip)  # the gripper's TCP in the block's frame
    tilt = float(np.arccos(np.clip(on_block[2, 2], -1.0, 1.0)))
    gap = float(abs(on_block[2, 3] - stock.lower[2]))
    if tilt > MAX_GRIPPER_TILT_RAD or gap > MAX_GRIPPER_GAP_M:
        gap_and_tilt = f"{mm(gap):.2f} mm and {np.rad2deg(tilt):.2f} deg"
        yield f"the block does not lie flat on {tool.name} (gap and tilt {gap_and_tilt})"
    half = 0.5 * np.array(tool.footprint)
    face = np.array([[x, y, 0.0] for x, y in itertools.product((-half[0], half[0]), (-half[1], half[1]))])
    face_on_block = transform(on_block, face)[:, :2]
    overhang = float(np.maximum(stock.lower[:2] - face_on_block, face_on_block - stock.upper[:2]).max())
    if overhang > MAX_GRIPPER_OVERHANG_M:
        yield f"the face of {tool.name} extends {mm(overhang):.2f} mm beyond the block's bottom face"
    mass = stock.mass
    if mass is None:
        yield "the block's mass is unknown"
        return
    if tool.holding_force < MIN_GRIP_FORCE_FACTOR * mass * GRAVITY:
        yield (
            f"{tool.name} holds with {tool.holding_force:.0f} N; required: "
            f"{MIN_GRIP_FORCE_FACTOR * mass * GRAVITY:.0f} N"
        )
    if tool.mass + mass > arm.data.payload:
        payload = arm.data.payload
        yield f"gripper and block weigh {tool.mass + mass:.2f} kg; payload of the arm: {payload:g} kg"


def _check_support(cell: Cell, stock: Stock, stock_pose: FloatArray, accepted: bool) -> Iterator[str]:
    """Check how a block is supported at a pose, and yield the faults as texts.

    - On pedestals: the height and the pedestal's size must be in stock. The pedestal must carry the block and
      stand itself. A block within 25 mm of the floor needs no pedestal.
    - With another stated support: the support must carry the block and stand itself.
    - Without support: the block must stand on the floor or a body of the cell.

    If the problem accepts the support, nothing is checked without pedestals. With pedestals, the range of
    heights is not checked then, and their overlap with bodies only if the problem states no place of the
    block.

    Args:
        cell: Cell of the setup.
        stock: The block.
        stock_pose: Pose (4, 4) of the block.
        accepted: Whether the problem accepts the stated support.
    """
    block = transform(stock_pose, _box_corners(stock))
    bottom = float(block[:, 2].min())
    floor = floor_height(cell)
    bodies = [transform(s.pose, hull_points(s)) for obstacle in cell.obstacles for s in obstacle.shapes]
    if stock.pedestal is not None:
        yield from _check_pedestal_height(stock, stock.pedestal, stock_pose, bottom - floor, accepted)
        if bottom - floor <= MAX_FEET_HEIGHT_M:
            return
    elif bottom < floor - MAX_FEET_HEIGHT_M - MAX_GRIPPER_OVERHANG_M and not accepted:
        yield f"the block extends {mm(floor - bottom):.0f} mm below the floor"
    shapes = support.with_support(cell, stock, stock_pose).support
    feet = [transform(stock_pose @ shape.pose, hull_points(shape)) for shape in shapes]
    if stock.pedestal is None and accepted:  # a support as stated, or a block that hangs
        return
    if stock.pedestal is None and not stock.support:
        gap = bottom - _support_height(block, floor, bodies)
        if gap > MAX_FEET_HEIGHT_M + MAX_GRIPPER_OVERHANG_M:
            yield f"the block is {mm(gap):.0f} mm above the nearest surface below, and no support is stated"
        return
    yield from _check_contact(block, feet)
    if not feet:
        return
    if stock.pedestal is not None and not (accepted and stock.place is not None):
        yield from _check_pedestal_overlap(feet[0], cell)
    lowest = min(feet, key=lambda corner_points: float(corner_points[:, 2].min()))
    gap = float(lowest[:, 2].min()) - _support_height(lowest, floor, bodies)
    if gap > MAX_FEET_HEIGHT_M + MAX_GRIPPER_OVERHANG_M:
        yield f"the support ends {mm(gap):.0f} mm above the surface below it"
    if stock.pedestal is not None:
        sides = [
            v
            for v, vertical in zip(shapes[0].size, (stock_pose @ shapes[0].pose)[2], strict=False)
            if abs(vertical) < 0.5
        ]
        if any(min(abs(v - side) for side in stock.pedestal.sides) > TOP_HEIGHT_TOLERANCE_M for v in sides):
            size = " x ".join(f"{mm(v):.0f}" for v in sides)
            yield f"no {stock.pedestal.kind} of {size} mm is in stock"


def _check_pedestal_height(
    stock: Stock, pedestal: Pedestal, stock_pose: FloatArray, height: float, accepted: bool
) -> Iterator[str]:
    """Check that a block is level and, at its height above the floor, stands on a pedestal in stock.

    If the problem states the place of the block, only the range of the heights is checked, unless the problem
    accepts the support. Faults are yielded as texts.

    Args:
        stock: The block.
        pedestal: Kinds and sizes of the pedestals on which the block may stand.
        stock_pose: Pose (4, 4) of the block.
        height: Height [m] of the block's lowest point above the floor.
        accepted: Whether the problem accepts the stated support.
    """
    kind, heights = pedestal.kind, pedestal.heights
    if float(np.abs(stock_pose[2, :3]).max()) < np.cos(MAX_GRIPPER_TILT_RAD):
        yield f"the block is tilted and cannot stand on a {kind}"
    if stock.place is None:
        if min(abs(height - allowed) for allowed in heights) > TOP_HEIGHT_TOLERANCE_M:
            yield f"the block is {mm(height):.2f} mm above the floor; no {kind} is that high"
    elif (
        height > max(heights) + TOP_HEIGHT_TOLERANCE_M or height < -MAX_FEET_HEIGHT_M - MAX_GRIPPER_OVERHANG_M
    ) and not accepted:
        max_height = mm(max(heights))
        yield f"the block is {mm(height):.0f} mm above the floor; a {kind} is up to {max_height:.0f} mm high"


def _check_pedestal_overlap(pedestal: FloatArray, cell: Cell) -> Iterator[str]:
    """Report the first body of the cell that is inside a pedestal with corners (8, 3) [m] in the world.

    A body that overlaps the pedestal in height by no more than that of feet and shims counts as its floor.
    """
    low, high = pedestal[:, 2].min(), pedestal[:, 2].max()
    outline = shapely.MultiPoint(pedestal[:, :2]).convex_hull
    for obstacle in cell.obstacles:
        for shape in obstacle.shapes:
            body = transform(shape.pose, hull_points(shape))
            overlap = min(float(body[:, 2].max() - low), float(high - body[:, 2].min()))
            common = shapely.MultiPoint(body[:, :2]).convex_hull & outline
            if overlap > MAX_FEET_HEIGHT_M and common.area > MAX_GRIPPER_OVERHANG_M:
                yield f"{obstacle.name} of the cell is inside the pedestal of the block"
                return


def _check_contact(block: FloatArray, shapes: list[FloatArray]) -> Iterator[str]:
    """Check how a block stands on the shapes of its support, and yield the faults as texts.

    A shape must be under the block and reach up to it. The centre of the block must be above the convex hull
    of the highest shapes. The block has corners (8, 3) [m] in the world, each shape (N, 3).
    """
    bottom, hull = float(block[:, 2].min()), ConvexHull(block[:, :2])
    outline = shapely.Polygon(block[hull.vertices, :2])
    parts = [
        shapely.MultiPoint(top[:, :2]).convex_hull & outline for top in shapes if top[:, 2].min() < bottom
    ]
    tops = [float(top[:, 2].max()) for top in shapes if top[:, 2].min() < bottom]
    contacts = [(highest, part) for highest, part in zip(tops, parts, strict=True) if part.area > 0.0]
    if not contacts:
        yield "no part of the support is under the block"
        return
    highest = max(top for top, _ in contacts)
    if bottom - highest > MAX_FEET_HEIGHT_M + MAX_GRIPPER_OVERHANG_M:
        yield f"the block is {mm(bottom - highest):.0f} mm above its support"
    contact_area = shapely.GeometryCollection(
        [part for top, part in contacts if top >= highest - MAX_FEET_HEIGHT_M - MAX_GRIPPER_OVERHANG_M]
    )
    offset = float(contact_area.convex_hull.distance(shapely.Point(outline.centroid)))
    if offset > MAX_GRIPPER_OVERHANG_M:
        yield f"the centre of the block is {mm(offset):.0f} mm outside its support"


def _support_height(body: FloatArray, floor: float, bodies: list[FloatArray]) -> float:
    """Return the height [m] of the surface that carries a body: the floor or the top of other bodies.

    All bodies are given by their corners (N, 3) [m] in the world and count as boxes. Boxes of about equal
    height carry the body together if its centre is above or between them. So a box under only one corner
    does not carry it.
    """
    low, high = body.min(axis=0), body.max(axis=0)
    centre = 0.5 * (low + high)[:2]
    boxes_below = [
        box
        for box in bodies
        if box[:, 2].min() <= low[2] + MAX_FEET_HEIGHT_M and not _are_disjoint(body[:, :2], box[:, :2])
    ]
    height = floor
    for box in boxes_below:
        top = float(box[:, 2].max())
        same_height = [
            other
            for other in boxes_below
            if abs(float(other[:, 2].max()) - top) <= MAX_FEET_HEIGHT_M + MAX_GRIPPER_OVERHANG_M
        ]
        first = np.min([np.maximum(low, other.min(axis=0))[:2] for other in same_height], axis=0)
        last = np.max([np.minimum(high, other.max(axis=0))[:2] for other in same_height], axis=0)
        if ((first <= centre + MAX_GRIPPER_OVERHANG_M) & (centre <= last + MAX_GRIPPER_OVERHANG_M)).all():
            height = max(height, min(top, float(low[2])))  # the box may reach into the body
    return height


def _are_disjoint(points: FloatArray, other_points: FloatArray) -> bool:
    """Return whether the bounding boxes of points (N, D) and (M, D) are disjoint."""
    return bool(
        (
            (points.min(axis=0) > other_points.max(axis=0)) | (other_points.min(axis=0) > points.max(axis=0))
        ).any()
    )


def _box_corners(stock: Stock) -> FloatArray:
    """Return the corners (8, 3) [m] of a block in its own frame."""
    low, high = stock.lower, stock.upper
    return np.array([[x, y, z] for x, y, z in itertools.product(*zip(low, high, strict=True))])
