"""Choice of the gripper that holds a block, and of its position, when a problem is read.

The choice depends only on the grippers of the cell, the block and the part, so that planner and proof get the
same problem.

A gripper fits if its face lies within the bottom face of the block, the wires that cut the part keep clear of
it, it holds the block firmly enough and the arm carries both. The mounted gripper is kept if it fits at the
centre of the block. Otherwise the one with the largest holding force is chosen, as close below the centre of
the part as possible.
"""

import dataclasses
import itertools
from collections.abc import Collection, Sequence
from typing import Final, NamedTuple

import numpy as np
import shapely
from shapely.geometry import Polygon, box
from shapely.geometry.base import BaseGeometry

from planner.geometry.arrays import FloatArray, RuledSurface, from_rpy, hull_points, inverse, transform
from planner.geometry.units import DEG, GRAVITY, MM
from planner.issue_codes import format_message
from planner.issues import Issue, Severity
from planner.problem import Part, Problem, Setup, Stock
from planner.reading.stock import GRIP_FORCE_FACTOR
from planner.tooling import Gripper, gripper_plate

GRIP_POINT_STEP_M: Final = 5.0 * MM
"""Grip points are multiples of this [m], if one of them is free."""
RULING_SPACING_M: Final = 5.0 * MM
"""Maximum distance [m] between sampled rulings; further rulings are interpolated between stated ones."""
EXTRA_WIRE_CLEARANCE_M: Final = 0.5 * MM
"""Extra clearance [m] of the wires beyond the margin: they run beside their rulings, and are sampled."""
DEFAULT_WIRE_MARGIN_M: Final = 10.0 * MM
"""Clearance [m] of wires from the gripper if the operation states no margin."""
FACE_THICKNESS_M: Final = 0.012
"""Thickness of the face of a gripper [m]."""
PLATE_STEP_M: Final = 10.0 * MM
"""Sizes of recommended plates are multiples of this [m]."""


class Grip(NamedTuple):
    """A gripper with its position on the bottom face of the block.

    Attributes:
        tool: Gripper.
        position: Position (2,) [m] of its centre on the bottom face.
        rotation: Rotation about the normal of the face [rad].
    """

    tool: Gripper
    position: tuple[float, float]
    rotation: float

    def pose(self, stock: Stock) -> FloatArray:
        """Return the pose (4, 4) of the stock frame in the TCP frame of the gripper."""
        on_block = from_rpy((*self.position, float(stock.lower[2])), (0.0, 0.0, self.rotation))
        return np.asarray(np.linalg.inv(on_block))


def choose_grips(problem: Problem, free: Collection[int]) -> Problem:
    """Choose a gripper and a grip for setups that state no grip.

    Nothing changes if nothing fits; later checks state the reason.

    Args:
        problem: Problem.
        free: Indices of operations that start a setup without a stated grip.
    """
    for index in sorted(free):
        setup = problem.setup_of(index)
        holder = next((arm for arm in setup.cell.arms if arm.name == setup.stock.held_by), None)
        if holder is None or not isinstance(holder.tool, Gripper) or setup.stock.mass is None:
            continue
        grip = choose_grip(setup, problem.part, _largest_margin(problem, setup))
        if grip is not None:
            problem = _apply_grip(problem, setup, holder.tool, grip)
    return problem


def _apply_grip(problem: Problem, setup: Setup, mounted: Gripper, grip: Grip) -> Problem:
    """Return the problem with the grip of a setup and a note, unchanged if the setup has this grip."""
    stock, first = setup.stock, setup.operations[0]
    is_changed = grip.tool is not mounted
    if not is_changed and np.allclose(grip.pose(stock), stock.grip, atol=1e-12):
        return problem
    position_text = ", ".join(f"{v / MM + 0.0:g}" for v in grip.position)
    rotation_text = f", rotated by {grip.rotation / DEG:g} deg" if grip.rotation else ""
    choice = f"one of {len(problem.cell.grippers)} in the cell" if is_changed else "the mounted one"
    pose = grip.pose(stock)
    xyz_text = ", ".join(f"{v / MM + 0.0:.6g}" for v in pose[:3, 3])
    rpy_text = f", rpy_deg: [0, 0, {-grip.rotation / DEG:g}]" if grip.rotation else ""
    gripper_key = f"gripper: {grip.tool.name}, " if is_changed else ""
    note = Issue(
        "stock.grip_chosen",
        format_message(
            "stock.grip_chosen",
            gripper=grip.tool.name,
            arm=stock.held_by,
            choice=choice,
            centre_mm=position_text,
            rotation_clause=rotation_text,
        ),
        Severity.NOTE,
        arm=stock.held_by,
        hint=f"to fix or change it, state it: {{{gripper_key}grip: {{xyz_mm: [{xyz_text}]{rpy_text}}}}}",
    )
    name = str(stock.held_by)
    # the first setup is in the cell and the stock, later ones are changes before their first operation
    change = problem.changes.get(first)
    if setup.number > 1 and change is not None:
        tools = {**change.tools, name: grip.tool} if is_changed else change.tools
        steps = change.steps
        if is_changed:
            other_steps = [
                s for s in steps if not (s.startswith("Mount the tool") and s.endswith(f"on arm {name}."))
            ]
            steps = (f"Mount the tool {grip.tool.name} on arm {name}.", *other_steps)
        fields = {**change.stock, "grip": grip.pose(stock), "grip_chosen": True}
        new_change = dataclasses.replace(change, tools=tools, stock=fields, steps=steps)
        problem = dataclasses.replace(problem, changes={**problem.changes, first: new_change})
    else:
        arms = tuple(
            dataclasses.replace(a, tool=grip.tool) if a.name == name else a for a in problem.cell.arms
        )
        new_stock = dataclasses.replace(problem.stock, grip=grip.pose(stock), grip_chosen=True)
        cell = dataclasses.replace(problem.cell, arms=arms)
        problem = dataclasses.replace(problem, cell=cell, stock=new_stock)
    return dataclasses.replace(problem, notes=(*problem.notes, note))


def choose_grip(setup: Setup, part: Part | None, margin: float) -> Grip | None:
    """Choose the gripper and grip for the block of a setup; None if nothing fits.

    Args:
        setup: Setup.
        part: Part, or None.
        margin: Clearance [m] of wires from a gripper.
    """
    stock = setup.stock
    arm = setup.cell.arm(str(stock.held_by))
    wires = _wire_sweep(setup, part)
    mounted = arm.tool
    payload = arm.data.payload
    grippers = [mounted, *setup.cell.grippers] if isinstance(mounted, Gripper) else list(setup.cell.grippers)
    strong_grippers = [gripper for gripper in grippers if can_hold(gripper, stock, payload)]
    if strong_grippers and strong_grippers[0] is mounted:
        centred_grip = Grip(strong_grippers[0], (0.0, 0.0), 0.0)
        if fits(centred_grip, stock, wires, margin):
            return centred_grip
    for tool in sorted(strong_grippers, key=lambda gripper: -gripper.holding_force):
        for rotation in (0.0, 90.0 * DEG):
            position = _best_grip_point(tool, rotation, stock, wires, margin)
            if position is not None:
                return Grip(tool, position, rotation)
    return None


def can_hold(tool: Gripper, stock: Stock, payload: float) -> bool:
    """Whether a gripper holds the block firmly enough and an arm with this payload [kg] carries both."""
    mass = stock.mass or 0.0
    return tool.mass + mass <= payload and GRIP_FORCE_FACTOR * mass * GRAVITY <= tool.holding_force


def fits(grip: Grip, stock: Stock, wires: "GripWirePaths", margin: float) -> bool:
    """Whether a grip is within the bottom face of the block and all wires keep clear of it."""
    free = _free_region(grip.tool, grip.rotation, stock, wires, margin)
    return bool(free.covers(shapely.Point(grip.position)))


def grip_advice(setup: Setup, part: Part | None, margin: float) -> str:
    """Return a hint on what would hold the block: the largest plate that fits, and where."""
    stock = setup.stock
    arm = setup.cell.arm(str(stock.held_by))
    wires = _wire_sweep(setup, part)
    largest = _largest_plate(stock, wires, margin)
    if largest is None:
        return "no gripper of 20 mm or more fits below the part"
    size, position, rotation = largest
    width, depth = (round(v / MM) for v in size)
    rotation_text = f", rotated by {rotation / DEG:g} deg" if rotation else ""
    place_text = f"[{position[0] / MM + 0.0:g}, {position[1] / MM + 0.0:g}] mm{rotation_text}"
    plate = gripper_plate(*size)
    text = (
        f"the largest plate that fits has width_mm: {width}, depth_mm: {depth}, with its centre at "
        f"{place_text}"
    )
    if not can_hold(plate, stock, arm.data.payload):
        required_force = GRIP_FORCE_FACTOR * (stock.mass or 0.0) * GRAVITY
        return f"{text}; it holds with {plate.holding_force:.0f} N, but {required_force:.0f} N are required"
    return f"{text}; add it to the cell's grippers, or mount it, and remove grip, so that Tandem chooses it"


def add_grip_advice(problem: Problem, issues: Sequence[Issue]) -> list[Issue]:
    """Return the issues of a problem, with hints for those of grips."""
    out = []
    for issue in issues:
        setup = next((s for s in problem.setups if _is_grip_issue(s, issue)), None)
        if setup is not None:
            hint = grip_advice(setup, problem.part, _largest_margin(problem, setup))
            issue = dataclasses.replace(issue, hint=hint)
        out.append(issue)
    return out


def _is_grip_issue(setup: Setup, issue: Issue) -> bool:
    field = f"operations.{setup.operations[0]}.setup" if setup.number > 1 else "stock"
    return issue.code in ("stock.footprint", "stock.grip_force") and (issue.field or "").startswith(field)


@dataclasses.dataclass(frozen=True)
class GripWirePaths:
    """Sweep of the wires beyond the block.

    Attributes:
        surfaces: Ruled surfaces along which wires run.
        floor: Height of the bottom face of the block [m].
        parts: Outlines on the bottom face of the pieces that stay held, None for a block without a part.
        middle: Centre of these outlines, or of the block [m].
        cache: Results of :meth:`crossings_below` by height.
    """

    surfaces: tuple[RuledSurface, ...]
    floor: float
    parts: BaseGeometry | None
    middle: tuple[float, float]
    cache: dict[float, FloatArray] = dataclasses.field(default_factory=dict)

    def crossings_below(self, below: float) -> FloatArray:
        """Return pieces (K, 2, 2) [m] of the curves in which wires cross a level below the bottom face.

        Args:
            below: Distance [m] of the level below the bottom face.
        """
        level = round(self.floor - below, 6)
        if level not in self.cache:
            self.cache[level] = _crossings(self.surfaces, level)
        return self.cache[level]


def _largest_margin(problem: Problem, setup: Setup) -> float:
    """Return the largest margin [m] that operations of a setup state."""
    stated = [getattr(problem.operations[i], "margin_mm", None) for i in setup.operations]
    return max((float(v) * MM for v in stated if v is not None), default=DEFAULT_WIRE_MARGIN_M)


def _wire_sweep(setup: Setup, part: Part | None) -> GripWirePaths:
    """Return the paths of the wires that cut the part: along the rulings of all its surfaces, extended."""
    stock = setup.stock
    floor = float(stock.lower[2])
    surfaces = () if part is None else part.ruled
    outlines = [_outline(surface, floor) for surface in surfaces if surface.closed and not surface.hole]
    valid_outlines = [outline for outline in outlines if outline is not None and outline.area > 0.0]
    parts = shapely.unary_union(valid_outlines) if valid_outlines else None
    centre = (0.5 * (stock.lower + stock.upper))[:2] if parts is None else np.array(parts.centroid.coords[0])
    return GripWirePaths(surfaces, floor, parts, (float(centre[0]), float(centre[1])))


def _crossings(surfaces: Sequence[RuledSurface], level: float) -> FloatArray:
    """Return pieces (K, 2, 2) [m] of the curves in which rulings cross the plane z = ``level``."""
    pieces = [np.zeros((0, 2, 2))]
    for surface in surfaces:
        points = _crossings_of_surface(surface, level)
        ends = np.stack([points, np.roll(points, -1, axis=0)], axis=1)
        pieces.append(ends if surface.closed else ends[:-1])
    segments = np.concatenate(pieces)
    return segments[np.isfinite(segments).all(axis=(1, 2))]


def _crossings_of_surface(surface: RuledSurface, level: float) -> FloatArray:
    """Return points (M', 2) [m] where rulings, and interpolated ones, cross z = ``level``.

    Points of horizontal rulings are NaN.
    """
    start, end = surface.start, surface.end
    if surface.closed:
        start, end = np.concatenate([start, start[:1]]), np.concatenate([end, end[:1]])
    spacing = np.maximum(
        np.linalg.norm(np.diff(start, axis=0), axis=1), np.linalg.norm(np.diff(end, axis=0), axis=1)
    )
    count = np.clip(np.ceil(spacing / RULING_SPACING_M), 1, 400).astype(int)
    index = np.concatenate([k + np.arange(n) / n for k, n in enumerate(count)])
    index = index if surface.closed else np.append(index, len(start) - 1.0)
    k = np.minimum(index.astype(int), len(start) - 2)
    fraction = (index - k)[:, None]
    first = start[k] + fraction * (start[k + 1] - start[k])
    last = end[k] + fraction * (end[k + 1] - end[k])
    rise = last[:, 2] - first[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        fraction_along = np.where(np.abs(rise) > 1e-9, (level - first[:, 2]) / rise, np.nan)
    return np.asarray(first[:, :2] + fraction_along[:, None] * (last - first)[:, :2])


def _outline(surface: RuledSurface, level: float) -> Polygon | None:
    """Return the outline of a closed surface at z = ``level``, None for fewer than three points."""
    points = _crossings_of_surface(surface, level)
    points = points[np.isfinite(points).all(axis=1)]
    return shapely.make_valid(Polygon(points)) if len(points) > 2 else None


def _gripper_extents(tool: Gripper) -> list[tuple[FloatArray, tuple[float, float]]]:
    """Return half width and depth (2,) [m] of each shape of a gripper, and its range below the face [m]."""
    out = []
    for shape in tool.shapes:
        points = transform(inverse(tool.tcp) @ shape.pose, hull_points(shape))
        low, high = points.min(axis=0), points.max(axis=0)
        out.append((np.maximum(np.abs(low[:2]), np.abs(high[:2])), (-float(high[2]), -float(low[2]))))
    return out


def _free_region(
    tool: Gripper, rotation: float, stock: Stock, wires: GripWirePaths, margin: float
) -> BaseGeometry:
    """Return where the centre of a gripper's face may be on the bottom face of the block."""
    half = 0.5 * np.array(tool.footprint if rotation == 0.0 else tool.footprint[::-1])
    low, high = stock.lower[:2] + half, stock.upper[:2] - half
    if (high < low - 1e-9).any():
        return Polygon()
    free: BaseGeometry = box(*(low - 1e-9), *(high + 1e-9))
    if wires.parts is not None:
        free = free.intersection(wires.parts)
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=2)))
    blocked = []
    for half_size, levels in _gripper_extents(tool):
        corners = signs * (
            (half_size if rotation == 0.0 else half_size[::-1]) + margin + EXTRA_WIRE_CLEARANCE_M
        )
        for below in levels:
            points = (wires.crossings_below(below)[:, :, None] + corners).reshape(-1, 8, 2)
            blocked += list(shapely.convex_hull(shapely.multipoints(points)))
    return free.difference(shapely.unary_union(blocked)) if blocked else free


def _best_grip_point(
    tool: Gripper, rotation: float, stock: Stock, wires: GripWirePaths, margin: float
) -> tuple[float, float] | None:
    """Return the grid point nearest to the centre of the part at which the face may be, or None."""
    free = _free_region(tool, rotation, stock, wires, margin)
    if free.is_empty:
        return None
    low, high = np.array(free.bounds).reshape(2, 2)
    for step in (GRIP_POINT_STEP_M, 1.0 * MM):
        axes = [
            np.arange(np.ceil(a / step), np.floor(b / step) + 1) * step
            for a, b in zip(low, high, strict=True)
        ]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        points = points[shapely.intersects_xy(free, points)] if len(points) else points
        if len(points):
            nearest = points[int(np.argmin(np.linalg.norm(points - wires.middle, axis=1)))]
            return float(round(nearest[0], 9)), float(round(nearest[1], 9))
    return None


def _largest_plate(
    stock: Stock, wires: GripWirePaths, margin: float
) -> tuple[tuple[float, float], tuple[float, float], float] | None:
    """Return approximately the largest plate that fits, in steps of `PLATE_STEP_M`.

    Returns:
        Width and depth [m], centre (2,) [m], and rotation [rad], which is 0; None if no plate fits.
    """
    free_region = _free_region(
        gripper_plate(2.0 * PLATE_STEP_M, 2.0 * PLATE_STEP_M), 0.0, stock, wires, margin
    )
    if free_region.is_empty:
        return None
    low, high = np.array(free_region.bounds).reshape(2, 2)
    axes = [
        np.arange(np.ceil(a / GRIP_POINT_STEP_M), np.floor(b / GRIP_POINT_STEP_M) + 1) * GRIP_POINT_STEP_M
        for a, b in zip(low, high, strict=True)
    ]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    centres = centres[shapely.intersects_xy(free_region, centres)] if len(centres) else centres
    edge_distance = np.minimum(stock.upper[:2] - centres, centres - stock.lower[:2])
    wire_points = np.concatenate(
        [wires.crossings_below(0.0).mean(axis=1), wires.crossings_below(FACE_THICKNESS_M).mean(axis=1)]
    )
    wire_distance = (
        np.abs(centres[:, None] - wire_points) - margin - EXTRA_WIRE_CLEARANCE_M - 0.5 * RULING_SPACING_M
    )
    sizes: list[tuple[float, float]] = []
    for depth in (
        np.arange(2, int(2.0 * max(edge_distance[:, 1], default=0.0) / PLATE_STEP_M) + 1) * PLATE_STEP_M
    ):
        half_width = np.where(wire_distance[..., 1] < 0.5 * depth, wire_distance[..., 0], np.inf).min(
            axis=1, initial=np.inf
        )
        half_sizes = np.where(
            edge_distance[:, 1] >= 0.5 * depth - 1e-9, np.minimum(half_width, edge_distance[:, 0]), 0.0
        )
        width = float(np.floor(2.0 * half_sizes.max() / PLATE_STEP_M + 1e-6) * PLATE_STEP_M)
        sizes += [(min(width, 2.0), float(depth))] if width >= 2.0 * PLATE_STEP_M else []
    for size in sorted(sizes, key=lambda candidate: -candidate[0] * candidate[1]):
        position = _best_grip_point(gripper_plate(*size), 0.0, stock, wires, margin)
        if position is not None:
            return size, position, 0.0
    return None
