"""Support of a block: the floor, a body of the cell, the stated support, or one made for it.

A table or pedestal is made as high as the block's pose requires.
"""

import dataclasses
import itertools
from typing import Final

import numpy as np
import shapely

from planner.geometry.arrays import FloatArray, IndexArray, Shape, hull_points, transform
from planner.geometry.units import MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, Severity
from planner.problem import Arm, Cell, Pedestal, Problem, Setup, Stock

MAX_FOOT_HEIGHT_M: Final = 0.025
"""Height [m] of feet, shims and clamps between two bodies of which one stands on the other."""
FLOOR_HINT: Final = "or correct the heights of the bases, the lowest of which defines the floor"
"""End of the hint for an unsupported block. The floor is at the lowest base."""
LEVEL_COSINE: Final = np.cos(np.deg2rad(1.0))
"""Cosine of the angle (1 degree) by which the side on which a block stands may be tilted."""


@dataclasses.dataclass(frozen=True)
class SupportGround:
    """Bodies of a cell that can bear others.

    Attributes:
        floor: Height of the floor [m].
        boxes: Boxes around the shapes of obstacles, lower and upper corner (K, 2, 3) [m].
        names: Names of these obstacles (K,).
    """

    floor: float
    boxes: FloatArray
    names: tuple[str, ...]

    @staticmethod
    def of(cell: Cell) -> "SupportGround":
        """Return the ground of a cell.

        The floor is level with the lowest upright base, but not above z = 0. For an arm on external axes, the
        height of its base with all of these axes at 0 counts.
        """
        upright = [float(_base_at_zero(arm)[2, 3]) for arm in cell.arms if arm.base[2, 2] > 0.5]
        boxes = [np.zeros((0, 2, 3))]
        names = []
        for obstacle in cell.obstacles:
            for shape in obstacle.shapes:
                points = transform(shape.pose, hull_points(shape))
                boxes.append(np.stack([points.min(axis=0), points.max(axis=0)])[None])
                names.append(obstacle.name)
        return SupportGround(min([0.0, *upright]), np.concatenate(boxes), tuple(names))

    def height_above(self, low: FloatArray, high: FloatArray) -> tuple[FloatArray, IndexArray]:
        """Return the height (K,) [m] of boxes above what bears them, and the index (K,) of its shape.

        The height is 0 or less if a box is inside what bears it. The index is -1 for the floor. A shape below
        a box bears it if this shape, together with all shapes of the same height, extends on both sides of
        the box's centre.

        Args:
            low: Lower corners (K, 3) [m].
            high: Upper corners (K, 3) [m].
        """
        gap = low[:, 2] - self.floor
        bearer = np.full(len(low), -1, dtype=np.intp)
        middle = 0.5 * (low + high)[:, :2]
        for k, (lower, upper) in enumerate(self.boxes):
            # rectangle around the overlaps, in plan view, with all shapes of the same height
            overlap_bounds = np.stack([np.full_like(middle, np.inf), np.full_like(middle, -np.inf)])
            same_height = np.abs(self.boxes[:, 1, 2] - upper[2]) <= MAX_FOOT_HEIGHT_M
            for other_lower, other_upper in self.boxes[same_height]:
                a, b = np.maximum(low[:, :2], other_lower[:2]), np.minimum(high[:, :2], other_upper[:2])
                overlaps = (a <= b).all(axis=1)[:, None]
                overlap_bounds[0] = np.where(overlaps, np.minimum(overlap_bounds[0], a), overlap_bounds[0])
                overlap_bounds[1] = np.where(overlaps, np.maximum(overlap_bounds[1], b), overlap_bounds[1])
            overlaps_box = (low[:, :2] <= upper[:2]).all(axis=1) & (high[:, :2] >= lower[:2]).all(axis=1)
            bears = overlaps_box & ((overlap_bounds[0] <= middle) & (middle <= overlap_bounds[1])).all(axis=1)
            height = low[:, 2] - upper[2]
            is_closer = bears & (low[:, 2] >= lower[2] - MAX_FOOT_HEIGHT_M) & (height < gap)
            gap, bearer = np.where(is_closer, height, gap), np.where(is_closer, k, bearer)
        return gap, bearer

    @property
    def has_bearing_bodies(self) -> bool:
        """Whether anything in the cell except the floor might bear a block."""
        return bool((self.boxes[:, 1, 2] > self.floor + MAX_FOOT_HEIGHT_M).any())


def block_corners(stock: Stock) -> FloatArray:
    """Return the corners (8, 3) [m] of the block as found, in the stock frame."""
    return np.array(list(itertools.product(*zip(stock.lower, stock.upper, strict=True))))


def underside(stock: Stock, poses: FloatArray) -> FloatArray:
    """Return the height (K,) [m] in the world of the lowest corner of a block at poses (K, 4, 4)."""
    return np.asarray(_transform_points(block_corners(stock), poses)[..., 2].min(axis=1))


def support_gap(ground: SupportGround, stock: Stock, poses: FloatArray) -> FloatArray:
    """Return the height (K,) [m] of a block's support, or of the block, above what is below it.

    Args:
        ground: Ground of the cell.
        stock: The block.
        poses: Poses of the block (K, 4, 4).
    """
    shapes = [transform(shape.pose, hull_points(shape)) for shape in stock.support] or [block_corners(stock)]
    feet = np.stack([_transform_points(points, poses)[..., 2].min(axis=1) for points in shapes])
    lowest = np.argmin(feet, axis=0)
    out = np.empty(len(poses))
    for k, points in enumerate(shapes):
        is_lowest = lowest == k
        world = _transform_points(points, poses[is_lowest])
        out[is_lowest] = ground.height_above(world.min(axis=1), world.max(axis=1))[0]
    return out


def bearing_body(cell: Cell, stock: Stock, pose: FloatArray) -> tuple[float, str]:
    """Return how high [m] a block's support is above what bears it, and the name of that obstacle.

    Without a support it is the height of the block itself. The name is empty for the floor. ``pose`` (4, 4)
    is that of the block.
    """
    shapes = [transform(shape.pose, hull_points(shape)) for shape in stock.support] or [block_corners(stock)]
    foot = min(
        (transform(pose, points) for points in shapes),
        key=lambda points_of_shape: float(points_of_shape[:, 2].min()),
    )
    ground = SupportGround.of(cell)
    gap, bearer = ground.height_above(foot.min(axis=0)[None], foot.max(axis=0)[None])
    return float(gap[0]), ground.names[int(bearer[0])] if bearer[0] >= 0 else ""


def with_support(cell: Cell, stock: Stock, stock_pose: FloatArray) -> Stock:
    """Return the stock with the table or pedestal that is made for it as its support.

    The support is a box of an available size, centred under the block. The stock has none if the block stands
    on the floor or is tilted. A stock with a stated support, or that an arm holds, is returned unchanged.

    Args:
        cell: The cell.
        stock: The stock.
        stock_pose: Pose of the stock (4, 4).
    """
    pedestal = stock.pedestal
    if pedestal is None or stock.held_by is not None:
        return stock
    height = float(underside(stock, stock_pose[None])[0]) - SupportGround.of(cell).floor
    up = stock_pose[2, :3]  # in the stock frame
    axis = int(np.argmax(np.abs(up)))
    if height <= MAX_FOOT_HEIGHT_M or abs(up[axis]) < LEVEL_COSINE:
        return dataclasses.replace(stock, support=())
    extent = stock.upper - stock.lower
    size, centre = np.empty(3), 0.5 * (stock.upper + stock.lower)
    for k in range(3):
        target_size = pedestal.width_fraction * extent[k] + 2.0 * pedestal.overhang
        if k == axis:
            size[k] = height
        elif pedestal.overhang:  # the smallest one that is wide enough
            size[k] = next((s for s in pedestal.sides if s >= target_size - 1e-9), pedestal.sides[-1])
        else:
            size[k] = max([s for s in pedestal.sides if s <= target_size + 1e-9], default=pedestal.sides[0])
    down = -np.sign(up[axis])
    face = stock.lower[axis] if down < 0 else stock.upper[axis]
    centre[axis] = face + down * 0.5 * height
    pose = np.eye(4)
    pose[:3, 3] = centre
    return dataclasses.replace(
        stock, support=(Shape("box", (float(size[0]), float(size[1]), float(size[2])), pose),)
    )


def stock_heights(cell: Cell, stock: Stock) -> FloatArray:
    """Return the heights (H,) [m] of the stock frame in the world, one for each available pedestal height.

    The block stands in its attitude on a pedestal (or table) on the floor. Empty if the problem does not ask
    for a pedestal to be made.
    """
    if stock.pedestal is None:
        return np.zeros(0)
    pose_at_origin = np.eye(4)
    pose_at_origin[:3, :3] = stock.attitude
    # height of the block's lowest corner if the stock frame is at the origin
    bottom = float(underside(stock, poses=pose_at_origin[None])[0])
    return np.asarray(SupportGround.of(cell).floor + np.array(stock.pedestal.heights) - bottom)


def support_note(cell: Cell, stock: Stock, pose: FloatArray) -> str:
    """Describe for users what a block at ``pose`` (4, 4) stands on, as a part of a sentence.

    It is a table or pedestal that is made for it, the stated support, a body of the cell, the floor, or
    nothing.
    """
    ground, supported = SupportGround.of(cell), with_support(cell, stock, pose)
    world = _transform_points(block_corners(stock), pose[None])[0]
    if stock.pedestal is not None and supported.support:
        sides = [
            v for k, v in enumerate(supported.support[0].size) if k != int(np.argmax(np.abs(pose[2, :3])))
        ]
        height = float(world[:, 2].min()) - ground.floor
        size = f"{sides[0] / MM:.0f} x {sides[1] / MM:.0f} mm, {height / MM:.0f} mm high from the floor"
        return f"a {stock.pedestal.kind} of {size}, centred under the block"
    if stock.support:
        gap = float(support_gap(ground, stock, pose[None])[0])
        foot = (
            "which stands on what is below it"
            if gap <= MAX_FOOT_HEIGHT_M
            else f"which ends {gap / MM:.0f} mm above what is below it"
        )
        return f"the support that the problem states, {foot}"
    gap, bearer = (v[0] for v in ground.height_above(world.min(axis=0)[None], world.max(axis=0)[None]))
    if gap > MAX_FOOT_HEIGHT_M:
        return f"nothing that is stated; it is {gap / MM:.0f} mm above what is below it"
    return "the floor" if bearer < 0 else f"the body {ground.names[bearer]} of the cell"


def support_issues(problem: Problem) -> list[Issue]:
    """Return issues on the supports of the blocks in all setups, as :func:`setup_support_issues`."""
    out: list[Issue] = []
    for setup in problem.setups:
        out += setup_support_issues(setup)
    return out


def setup_support_issues(setup: Setup) -> list[Issue]:
    """Return issues on the support of the block in one setup, before planning.

    Nothing is required of held stocks and clamped sheets. If the pose of the block is not stated, only what
    does not depend on it is checked. At most one issue is returned.
    """
    setup = setup.with_zero_tilt
    stock, cell = setup.stock, setup.cell
    if stock.held_by is not None or stock.sheet is not None:
        return []
    field = f"operations.{setup.operations[0]}.setup.support" if setup.number > 1 else "stock.support"
    attitude = stock.attitude if stock.place is None else stock.place[:3, :3]
    if stock.pedestal is not None:
        if np.abs(attitude[2]).max() < LEVEL_COSINE:
            message = f"{field}: a tilted block stands on no {stock.pedestal.kind}; state the shapes of its "
            return [Issue("problem.field", message + "support", field=field)]
        if stock.place is None:
            return []
        return _pedestal_height_issues(cell, stock, stock.pedestal, stock.place, field)
    if not stock.support:
        if stock.place is None:
            if SupportGround.of(cell).has_bearing_bodies:
                return []
            reason = "its place is searched, and no support is stated"
            return [_unsupported_issue(reason, field, gap=None)]
        depth_below_floor = _depth_below_floor(cell, stock, stock.place)
        if depth_below_floor > MAX_FOOT_HEIGHT_M:
            issue = _unsupported_issue("", field, depth_below_floor)
            message = (
                f"the block is {depth_below_floor / MM:.0f} mm below the floor; allowed are "
                f"{MAX_FOOT_HEIGHT_M / MM:g} mm"
            )
            hint = f"move it by {depth_below_floor / MM:.0f} mm in z, {FLOOR_HINT}"
            return [dataclasses.replace(issue, message=message, hint=hint)]
        gap = float(support_gap(SupportGround.of(cell), stock, stock.place[None])[0])
        return (
            []
            if gap <= MAX_FOOT_HEIGHT_M
            else [_unsupported_issue(f"it is {gap / MM:.0f} mm above what is below it", field, gap)]
        )
    pose_at_origin = np.eye(4)
    pose_at_origin[:3, :3] = attitude
    deviations = _support_deviations(stock, pose_at_origin)
    if stock.place is not None:
        gap = float(support_gap(SupportGround.of(cell), stock, stock.place[None])[0])
        message = f"the support under the block ends {gap / MM:.0f} mm above what is below it"
        deviations.append((gap, MAX_FOOT_HEIGHT_M, message))
        depth_below_floor = _depth_below_floor(cell, stock, stock.place)
        message = f"the block is {depth_below_floor / MM:.0f} mm below the floor"
        deviations.insert(0, (depth_below_floor, MAX_FOOT_HEIGHT_M, message))
    hint = "make it longer, put it under the middle of the block, add what it stands on to the cell's "
    hint += "obstacles, or let Tandem make one: support: pedestal"
    return [
        _support_issue(message, field, value, limit, hint)
        for value, limit, message in deviations
        if value > limit + 1e-9
    ][:1]


def _depth_below_floor(cell: Cell, stock: Stock, pose: FloatArray) -> float:
    """Return how far [m] the lowest corner of a block at ``pose`` (4, 4) is below the floor."""
    return SupportGround.of(cell).floor - float(underside(stock, pose[None])[0])


def _support_deviations(stock: Stock, pose: FloatArray) -> list[tuple[float, float, str]]:
    """Measure how far a block at ``pose`` (4, 4) is above its stated support, and beside it.

    Only shapes that are under the block count. If there are none, that is the only deviation.

    Returns:
        For each deviation its value [m], its limit [m] and a message.
    """
    block = _transform_points(block_corners(stock), pose[None])[0]
    # outlines in plan view: of the block, and of the part of each shape of the support that is under it
    low, block_outline = float(block[:, 2].min()), shapely.MultiPoint(block[:, :2]).convex_hull
    shapes = [transform(pose @ shape.pose, hull_points(shape)) for shape in stock.support]
    outlines = [shapely.MultiPoint(shape[:, :2]).convex_hull.intersection(block_outline) for shape in shapes]
    tops = np.array([float(shape[:, 2].max()) for shape in shapes])
    feet = np.array([float(shape[:, 2].min()) for shape in shapes])
    is_below = (feet < low) & np.array([outline.area > 0.0 for outline in outlines])
    if not is_below.any():
        support_outline = shapely.MultiPoint(np.concatenate(shapes)[:, :2]).convex_hull
        offset = float(support_outline.distance(block_outline.centroid)) or float(np.abs(tops - low).min())
        return [(offset, 0.0, "nothing of the support is under the block")]
    top = float(tops[is_below].max())
    bears = is_below & (tops >= top - MAX_FOOT_HEIGHT_M)
    bearing = [outline for outline, is_bearing in zip(outlines, bears, strict=True) if is_bearing]
    offset = float(shapely.unary_union(bearing).convex_hull.distance(block_outline.centroid))
    gap = low - top
    tip_message = f"the middle of the block is {offset / MM:.0f} mm beside its support, so the block tips"
    return [
        (gap, MAX_FOOT_HEIGHT_M, f"the block hangs {gap / MM:.0f} mm above its support"),
        (offset, 0.0, tip_message),
    ]


def _pedestal_height_issues(
    cell: Cell, stock: Stock, pedestal: Pedestal, pose: FloatArray, field: str
) -> list[Issue]:
    """Return an issue if the table or pedestal under a block at ``pose`` (4, 4) cannot be made.

    It would be too high, below the floor, or inside an obstacle. ``field`` is the field of the problem.
    """
    height = float(underside(stock, pose[None])[0]) - SupportGround.of(cell).floor
    max_height, kind = pedestal.heights[-1], pedestal.kind
    if height < -MAX_FOOT_HEIGHT_M:
        message = f"the block is {-height / MM:.0f} mm below the floor, where no {kind} is possible"
        hint = f"correct its place, {FLOOR_HINT}; or remove support"
        return [_support_issue(message, field, -height, MAX_FOOT_HEIGHT_M, hint)]
    if height > max_height + 1e-9:
        message = f"the {kind} under the block would be {height / MM:.0f} mm high; available are at most "
        message += f"{max_height / MM:.0f} mm"
        hint = (
            f"put the block lower, at most {max_height / MM:.0f} mm above the floor, or state the shapes of "
            "its "
        )
        hint += "support"
        return [_support_issue(message, field, height, max_height, hint)]
    name, depth = pedestal_overlap(cell, stock, pose)
    if depth > MAX_FOOT_HEIGHT_M:
        message = f"the {kind} under the block would be {depth / MM:.0f} mm inside {name}"
        hint = f"state the shapes of a support that stands on it, or put the block or {name} elsewhere"
        return [_support_issue(message, field, depth, MAX_FOOT_HEIGHT_M, hint)]
    return []


def pedestal_overlap(cell: Cell, stock: Stock, pose: FloatArray) -> tuple[str, float]:
    """Return the obstacle that the support made for a block overlaps deepest, and the depth [m].

    ``pose`` (4, 4) is that of the block. The name is empty if the support overlaps none.
    """
    shapes = () if stock.pedestal is None else with_support(cell, stock, pose).support
    overlaps = [_deepest_obstacle(transform(pose @ shape.pose, hull_points(shape)), cell) for shape in shapes]
    return max(overlaps, key=lambda overlap: overlap[1], default=("", 0.0))


def _deepest_obstacle(box_corners: FloatArray, cell: Cell) -> tuple[str, float]:
    """Return the obstacle that an upright box with corners (8, 3) overlaps deepest, and the depth [m]."""
    box_outline = shapely.MultiPoint(box_corners[:, :2]).convex_hull
    depths = [("", 0.0)]
    for obstacle in cell.obstacles:
        for points in (transform(shape.pose, hull_points(shape)) for shape in obstacle.shapes):
            depth = min(
                points[:, 2].max() - box_corners[:, 2].min(), box_corners[:, 2].max() - points[:, 2].min()
            )
            if box_outline.intersection(shapely.MultiPoint(points[:, :2]).convex_hull).area > 1e-6:
                depths.append((obstacle.name, float(depth)))
    return max(depths, key=lambda item: item[1])


def _support_issue(message: str, field: str, value: float, limit: float, hint: str) -> Issue:
    """Return the warning ``stock.support`` of a value [m] that exceeds its limit [m].

    The message also states the limit if it is the height that is allowed for feet.
    """
    if limit == MAX_FOOT_HEIGHT_M:
        message += f"; allowed are {MAX_FOOT_HEIGHT_M / MM:g} mm for feet"
    return Issue(
        "stock.support",
        message,
        Severity.WARNING,
        field=field,
        **measurement(value / MM, limit / MM, "mm"),
        hint=hint,
        accepted=False,
    )


def _unsupported_issue(reason: str, field: str, gap: float | None) -> Issue:
    """Return the warning ``stock.hangs`` of a block without support, ``gap`` [m] above what is below it."""
    return Issue(
        "stock.hangs",
        format_message("stock.hangs", reason=reason),
        Severity.WARNING,
        field=field,
        value=None if gap is None else gap / MM,
        limit=None if gap is None else MAX_FOOT_HEIGHT_M / MM,
        unit=None if gap is None else "mm",
        hint="state its support by shapes, or let Tandem make one that arms keep clear of: "
        "support: pedestal, or support: table",
        accepted=False,
    )


def _transform_points(points: FloatArray, poses: FloatArray) -> FloatArray:
    """Return points (N, 3) at poses (K, 4, 4), as (K, N, 3)."""
    return np.asarray(np.einsum("kij,nj->kni", poses[:, :3, :3], points) + poses[:, None, :3, 3])


def _base_at_zero(arm: Arm) -> FloatArray:
    """Return the base (4, 4) of an arm with the axes under it at 0."""
    return arm.at_stations(dict.fromkeys(arm.axes_by_name, 0.0)).base
