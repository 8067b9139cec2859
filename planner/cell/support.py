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

        The floor is level with the lowest upright base, at most at 0. A track has its base at value 0 there,
        wherever it moves.
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
        """Return the height (K,) [m] of boxes above what bears them, and the index of that obstacle's shape.

        The height is 0 or less if a box is inside what bears it. The index is -1 for the floor. A shape below
        a box bears it if, with all shapes of equal height, it extends on both sides of the box's centre.

        Args:
            low: Lower corners (K, 3) [m].
            high: Upper corners (K, 3) [m].
        """
        gap = low[:, 2] - self.floor
        what = np.full(len(low), -1, dtype=np.intp)
        middle = 0.5 * (low + high)[:, :2]
        for k, (first, last) in enumerate(self.boxes):
            around = np.stack([np.full_like(middle, np.inf), np.full_like(middle, -np.inf)])
            for box_low, other in self.boxes[np.abs(self.boxes[:, 1, 2] - last[2]) <= MAX_FOOT_HEIGHT_M]:
                a, b = np.maximum(low[:, :2], box_low[:2]), np.minimum(high[:, :2], other[:2])
                over = (a <= b).all(axis=1)[:, None]
                around[0] = np.where(over, np.minimum(around[0], a), around[0])
                around[1] = np.where(over, np.maximum(around[1], b), around[1])
            overlaps_box = (low[:, :2] <= last[:2]).all(axis=1) & (high[:, :2] >= first[:2]).all(axis=1)
            bears = overlaps_box & ((around[0] <= middle) & (middle <= around[1])).all(axis=1)
            height = low[:, 2] - last[2]
            is_closer = bears & (low[:, 2] >= first[2] - MAX_FOOT_HEIGHT_M) & (height < gap)
            gap, what = np.where(is_closer, height, gap), np.where(is_closer, k, what)
        return gap, what

    @property
    def has_bearing_bodies(self) -> bool:
        """Whether anything in the cell except the floor might bear a block."""
        return bool((self.boxes[:, 1, 2] > self.floor + MAX_FOOT_HEIGHT_M).any())


def block_corners(stock: Stock) -> FloatArray:
    """Return the corners (8, 3) [m] of the block as found, in the stock frame."""
    return np.array(list(itertools.product(*zip(stock.lower, stock.upper, strict=True))))


def underside(stock: Stock, poses: FloatArray) -> FloatArray:
    """Return the height (K,) [m] of the lowest corner of a block at poses (K, 4, 4)."""
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
    """Return the height [m] of a block's support, or of the block, above what is below it, and its name.

    The name is that of an obstacle, or empty for the floor.
    """
    shapes = [transform(shape.pose, hull_points(shape)) for shape in stock.support] or [block_corners(stock)]
    foot = min(
        (transform(pose, points) for points in shapes),
        key=lambda points_of_shape: float(points_of_shape[:, 2].min()),
    )
    ground = SupportGround.of(cell)
    gap, what = ground.height_above(foot.min(axis=0)[None], foot.max(axis=0)[None])
    return float(gap[0]), ground.names[int(what[0])] if what[0] >= 0 else ""


def with_support(cell: Cell, stock: Stock, stock_pose: FloatArray) -> Stock:
    """Return the stock with the table or pedestal that is made for it as its support.

    It is a box of an available size, centred under the block. There is none if the block stands on the floor
    or is tilted.

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
    """Return the heights [m] of the stock frame in the world for blocks on available supports."""
    if stock.pedestal is None:
        return np.zeros(0)
    rotation = np.eye(4)
    rotation[:3, :3] = stock.attitude
    bottom = float(underside(stock, rotation[None])[0])
    return np.asarray(SupportGround.of(cell).floor + np.array(stock.pedestal.heights) - bottom)


def support_note(cell: Cell, stock: Stock, pose: FloatArray) -> str:
    """Return in words what a block at ``pose`` (4, 4) stands on."""
    ground, supported = SupportGround.of(cell), with_support(cell, stock, pose)
    world = _transform_points(block_corners(stock), pose[None])[0]
    if stock.pedestal is not None and supported.support:
        sides = [
            v for k, v in enumerate(supported.support[0].size) if k != int(np.argmax(np.abs(pose[2, :3])))
        ]
        high = float(world[:, 2].min()) - ground.floor
        size = f"{sides[0] / MM:.0f} x {sides[1] / MM:.0f} mm, {high / MM:.0f} mm high from the floor"
        return f"a {stock.pedestal.kind} of {size}, centred under the block"
    if stock.support:
        gap = float(support_gap(ground, stock, pose[None])[0])
        foot = (
            "which stands on what is below it"
            if gap <= MAX_FOOT_HEIGHT_M
            else f"which ends {gap / MM:.0f} mm above what is below it"
        )
        return f"the support that the problem states, {foot}"
    gap, what = (v[0] for v in ground.height_above(world.min(axis=0)[None], world.max(axis=0)[None]))
    if gap > MAX_FOOT_HEIGHT_M:
        return f"nothing that is stated; it is {gap / MM:.0f} mm above what is below it"
    return "the floor" if what < 0 else f"the body {ground.names[what]} of the cell"


def support_issues(problem: Problem) -> list[Issue]:
    """Return issues on how the blocks of a problem stand, as far as they are known before their poses are."""
    out: list[Issue] = []
    for setup in problem.setups:
        out += setup_support_issues(setup)
    return out


def setup_support_issues(setup: Setup) -> list[Issue]:
    """Return issues on how the block of one setup stands, as far as they are known before its pose is."""
    setup = setup.with_zero_tilt
    stock, cell = setup.stock, setup.cell
    if stock.held_by is not None or stock.sheet is not None:
        return []
    field = f"operations.{setup.operations[0]}.setup.support" if setup.number > 1 else "stock.support"
    attitude = stock.attitude if stock.place is None else stock.place[:3, :3]
    if stock.pedestal is not None:
        if np.abs(attitude[2]).max() < LEVEL_COSINE:
            what = f"{field}: a tilted block stands on no {stock.pedestal.kind}; state the shapes of its "
            return [Issue("problem.field", what + "support", field=field)]
        return (
            []
            if stock.place is None
            else _pedestal_height_issues(cell, stock, stock.pedestal, stock.place, field)
        )
    if not stock.support:
        if stock.place is None:
            why = "its place is searched, and no support is stated"
            return [] if SupportGround.of(cell).has_bearing_bodies else [_unsupported_issue(why, field, None)]
        if (depth_below_floor := _depth_below_floor(cell, stock, stock.place)) > MAX_FOOT_HEIGHT_M:
            lost = _unsupported_issue("", field, depth_below_floor)
            what = (
                f"the block is {depth_below_floor / MM:.0f} mm below the floor; allowed are "
                f"{MAX_FOOT_HEIGHT_M / MM:g} mm"
            )
            return [
                dataclasses.replace(
                    lost, message=what, hint=f"move it by {depth_below_floor / MM:.0f} mm in z, {FLOOR_HINT}"
                )
            ]
        gap = float(support_gap(SupportGround.of(cell), stock, stock.place[None])[0])
        return (
            []
            if gap <= MAX_FOOT_HEIGHT_M
            else [_unsupported_issue(f"it is {gap / MM:.0f} mm above what is below it", field, gap)]
        )
    rotation_pose = np.eye(4)
    rotation_pose[:3, :3] = attitude
    out = _support_deviations(stock, rotation_pose)
    if stock.place is not None:
        gap = float(support_gap(SupportGround.of(cell), stock, stock.place[None])[0])
        out.append(
            (
                gap,
                MAX_FOOT_HEIGHT_M,
                f"the support under the block ends {gap / MM:.0f} mm above what is below it",
            )
        )
        depth_below_floor = _depth_below_floor(cell, stock, stock.place)
        out.insert(
            0,
            (
                depth_below_floor,
                MAX_FOOT_HEIGHT_M,
                f"the block is {depth_below_floor / MM:.0f} mm below the floor",
            ),
        )
    hint = "make it longer, put it under the middle of the block, add what it stands on to the cell's "
    hint += "obstacles, or let Tandem make one: support: pedestal"
    return [
        _support_issue(what, field, value, limit, hint) for value, limit, what in out if value > limit + 1e-9
    ][:1]


def _depth_below_floor(cell: Cell, stock: Stock, pose: FloatArray) -> float:
    """Return how far [m] a block at ``pose`` (4, 4) is below the floor."""
    return SupportGround.of(cell).floor - float(underside(stock, pose[None])[0])


def _support_deviations(stock: Stock, pose: FloatArray) -> list[tuple[float, float, str]]:
    """Return how far [m] a block at ``pose`` (4, 4) is above its support and beside it.

    Each value comes with its limit [m] and a text. The block may be rotated and moved.
    """
    block = _transform_points(block_corners(stock), pose[None])[0]
    low, seen = float(block[:, 2].min()), shapely.MultiPoint(block[:, :2]).convex_hull
    shapes = [transform(pose @ shape.pose, hull_points(shape)) for shape in stock.support]
    views = [shapely.MultiPoint(shape[:, :2]).convex_hull.intersection(seen) for shape in shapes]
    tops = np.array([float(shape[:, 2].max()) for shape in shapes])
    feet = np.array([float(shape[:, 2].min()) for shape in shapes])
    below = (feet < low) & np.array([view.area > 0.0 for view in views])
    if not below.any():
        around = shapely.MultiPoint(np.concatenate(shapes)[:, :2]).convex_hull
        aside = float(around.distance(seen.centroid)) or float(np.abs(tops - low).min())
        return [(aside, 0.0, "nothing of the support is under the block")]
    top = float(tops[below].max())
    bearing = [
        view for view, use in zip(views, below & (tops >= top - MAX_FOOT_HEIGHT_M), strict=True) if use
    ]
    aside = float(shapely.unary_union(bearing).convex_hull.distance(seen.centroid))
    hang, words = (
        low - top,
        f"the middle of the block is {aside / MM:.0f} mm beside its support, so the block tips",
    )
    return [
        (hang, MAX_FOOT_HEIGHT_M, f"the block hangs {hang / MM:.0f} mm above its support"),
        (aside, 0.0, words),
    ]


def _pedestal_height_issues(
    cell: Cell, stock: Stock, pedestal: Pedestal, pose: FloatArray, field: str
) -> list[Issue]:
    """Return issues on the height of what is made under a block with a stated pose."""
    high = float(underside(stock, pose[None])[0]) - SupportGround.of(cell).floor
    max_height, kind = pedestal.heights[-1], pedestal.kind
    if high < -MAX_FOOT_HEIGHT_M:
        what = f"the block is {-high / MM:.0f} mm below the floor, where no {kind} is possible"
        hint = f"correct its place, {FLOOR_HINT}; or remove support"
        return [_support_issue(what, field, -high, MAX_FOOT_HEIGHT_M, hint)]
    if high > max_height + 1e-9:
        what = f"the {kind} under the block would be {high / MM:.0f} mm high; available are at most "
        what += f"{max_height / MM:.0f} mm"
        hint = (
            f"put the block lower, at most {max_height / MM:.0f} mm above the floor, or state the shapes of "
            "its "
        )
        hint += "support"
        return [_support_issue(what, field, high, max_height, hint)]
    name, deep = pedestal_overlap(cell, stock, pose)
    if deep > MAX_FOOT_HEIGHT_M:
        what = f"the {kind} under the block would be {deep / MM:.0f} mm inside {name}"
        hint = f"state the shapes of a support that stands on it, or put the block or {name} elsewhere"
        return [_support_issue(what, field, deep, MAX_FOOT_HEIGHT_M, hint)]
    return []


def pedestal_overlap(cell: Cell, stock: Stock, pose: FloatArray) -> tuple[str, float]:
    """Return the obstacle that the support made for a block enters deepest, and the depth [m].

    ``pose`` (4, 4) is that of the block.
    """
    shapes = () if stock.pedestal is None else with_support(cell, stock, pose).support
    overlaps = [_deepest_obstacle(transform(pose @ shape.pose, hull_points(shape)), cell) for shape in shapes]
    return max(overlaps, key=lambda overlap: overlap[1], default=("", 0.0))


def _deepest_obstacle(box_corners: FloatArray, cell: Cell) -> tuple[str, float]:
    """Return the obstacle that an upright box with corners (8, 3) enters deepest, and the depth [m]."""
    view = shapely.MultiPoint(box_corners[:, :2]).convex_hull
    depths = [("", 0.0)]
    for obstacle in cell.obstacles:
        for body in (transform(item.pose, hull_points(item)) for item in obstacle.shapes):
            deep = min(body[:, 2].max() - box_corners[:, 2].min(), box_corners[:, 2].max() - body[:, 2].min())
            if view.intersection(shapely.MultiPoint(body[:, :2]).convex_hull).area > 1e-6:
                depths.append((obstacle.name, float(deep)))
    return max(depths, key=lambda item: item[1])


def _support_issue(what: str, field: str, value: float, limit: float, hint: str) -> Issue:
    if limit == MAX_FOOT_HEIGHT_M:
        what += f"; allowed are {MAX_FOOT_HEIGHT_M / MM:g} mm for feet"
    return Issue(
        "stock.support",
        what,
        Severity.WARNING,
        field=field,
        **measurement(value / MM, limit / MM, "mm"),
        hint=hint,
        accepted=False,
    )


def _unsupported_issue(why: str, field: str, gap: float | None) -> Issue:
    return Issue(
        "stock.hangs",
        format_message("stock.hangs", reason=why),
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
