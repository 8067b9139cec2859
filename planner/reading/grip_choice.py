"""Which gripper of the cell holds a block, and where: chosen when a problem is read, from the list in the
cell, the block and the wanted part alone, so that planner and proof find one and the same problem.

A gripper fits if its face lies within the block's bottom face, the wires that cut the part stay away from it,
it holds the block firmly enough and the arm carries both. The one that is mounted is kept if it fits at the
middle of the block; else the firmest one is taken, as near below the middle of the part as it can be.
"""

import dataclasses
import itertools
from collections.abc import Collection, Sequence
from typing import Final, NamedTuple

import numpy as np
import shapely
from shapely.geometry import Polygon, box
from shapely.geometry.base import BaseGeometry

from planner.geometry.arrays import FloatArray, Ruled, corners, from_rpy, inverse, transform
from planner.geometry.units import DEG, GRAVITY, MM
from planner.issues import Issue, Severity
from planner.problem import Part, Problem, Setup, Stock
from planner.reading.stock import GRIP_FORCE_FACTOR
from planner.tooling import Gripper, gripper_plate

GRIP_POINT_STEP: Final = 5.0 * MM
"""Grip points are multiples of this [m], where one of them is free."""
RULING_SPACING: Final = 5.0 * MM
"""Rulings between two that are stated are at most so far apart [m]."""
WIRE_SPARE: Final = 0.5 * MM
"""How much more than the margin the wires keep off [m]: they run beside their rulings, and are sampled."""
WIRE_MARGIN: Final = 10.0 * MM
"""What wires keep off the gripper [m] where the operation states no margin."""
FACE_THICKNESS: Final = 0.012
"""[m] thickness of the face."""
PLATE_STEP: Final = 10.0 * MM
"""Sizes of plates that are advised are multiples of this [m]."""


class Grip(NamedTuple):
    """A gripper with its middle at ``at`` (2,) [m] of the block's bottom face, turned by ``turn`` [rad]."""

    tool: Gripper
    at: tuple[float, float]
    turn: float

    def pose(self, stock: Stock) -> FloatArray:
        """The block's frame in the gripper's TCP frame (4, 4)."""
        on_block = from_rpy((*self.at, float(stock.lower[2])), (0.0, 0.0, self.turn))
        return np.asarray(np.linalg.inv(on_block))


def with_choices(problem: Problem, free: Collection[int]) -> Problem:
    """The problem with a gripper and a grip chosen for every setup whose first operation is in ``free``,
    which states no grip. Nothing is changed where nothing fits: the checks that follow say why."""
    for index in sorted(free):
        setup = problem.setup_of(index)
        holder = next((arm for arm in setup.cell.arms if arm.name == setup.stock.held_by), None)
        if holder is None or not isinstance(holder.tool, Gripper) or setup.stock.mass is None:
            continue
        found = choose(setup, problem.part, _margin(problem, setup))
        if found is not None:
            problem = _with(problem, setup, holder.tool, found)
    return problem


def _with(problem: Problem, setup: Setup, mounted: Gripper, found: Grip) -> Problem:
    stock, first = setup.stock, setup.operations[0]
    changed = found.tool is not mounted
    if not changed and np.allclose(found.pose(stock), stock.grip, atol=1e-12):
        return problem
    where = ", ".join(f"{v / MM + 0.0:g}" for v in found.at)
    turned = f", turned by {found.turn / DEG:g} deg" if found.turn else ""
    which = f"one of {len(problem.cell.grippers)} in the cell" if changed else "the one that is mounted"
    pose = found.pose(stock)
    at = ", ".join(f"{v / MM + 0.0:.6g}" for v in pose[:3, 3])
    rpy = f", rpy_deg: [0, 0, {-found.turn / DEG:g}]" if found.turn else ""
    named = f"gripper: {found.tool.name}, " if changed else ""
    told = Issue(
        "stock.grip_chosen",
        f"the block is held by {found.tool.name} of arm {stock.held_by} "
        f"({which}), its middle at [{where}] mm of the block's bottom face{turned}",
        Severity.NOTE,
        arm=stock.held_by,
        hint=f"to keep it so, or to have it otherwise, state it: {{{named}grip: {{xyz_mm: [{at}]{rpy}}}}}",
    )
    name = str(stock.held_by)
    change = problem.changes.get(first)
    if setup.number > 1 and change is not None:
        tools = {**change.tools, name: found.tool} if changed else change.tools
        steps = change.steps
        if changed:
            own = [s for s in steps if not (s.startswith("Mount the tool") and s.endswith(f"on arm {name}."))]
            steps = (f"Mount the tool {found.tool.name} on arm {name}.", *own)
        fields = {**change.stock, "grip": found.pose(stock), "grip_chosen": True}
        new = dataclasses.replace(change, tools=tools, stock=fields, steps=steps)
        problem = dataclasses.replace(problem, changes={**problem.changes, first: new})
    else:
        arms = tuple(
            dataclasses.replace(a, tool=found.tool) if a.name == name else a for a in problem.cell.arms
        )
        own_stock = dataclasses.replace(problem.stock, grip=found.pose(stock), grip_chosen=True)
        cell = dataclasses.replace(problem.cell, arms=arms)
        problem = dataclasses.replace(problem, cell=cell, stock=own_stock)
    return dataclasses.replace(problem, notes=(*problem.notes, told))


def choose(setup: Setup, part: Part | None, margin: float) -> Grip | None:
    """The gripper and grip for the block of a setup, None where nothing fits; ``margin`` [m] is what wires
    keep off a gripper."""
    stock = setup.stock
    arm = setup.cell.arm(str(stock.held_by))
    wires = _wires(setup, part)
    mounted = arm.tool
    payload = arm.data.payload
    known = [mounted, *setup.cell.grippers] if isinstance(mounted, Gripper) else list(setup.cell.grippers)
    strong = [one for one in known if can_hold(one, stock, payload)]
    if strong and strong[0] is mounted:
        usual = Grip(strong[0], (0.0, 0.0), 0.0)
        if fits(usual, stock, wires, margin):
            return usual
    for tool in sorted(strong, key=lambda one: -one.holding):
        for turn in (0.0, 90.0 * DEG):
            at = _place(tool, turn, stock, wires, margin)
            if at is not None:
                return Grip(tool, at, turn)
    return None


def can_hold(tool: Gripper, stock: Stock, payload: float) -> bool:
    """Whether a gripper holds the block firmly enough and an arm of that ``payload`` [kg] carries both."""
    mass = stock.mass or 0.0
    return tool.mass + mass <= payload and GRIP_FORCE_FACTOR * mass * GRAVITY <= tool.holding


def fits(grip: Grip, stock: Stock, wires: "Wires", margin: float) -> bool:
    """Whether a grip is within the block's bottom face and all wires stay away from it."""
    free = _free(grip.tool, grip.turn, stock, wires, margin)
    return bool(free.covers(shapely.Point(grip.at)))


def advice(setup: Setup, part: Part | None, margin: float) -> str:
    """What would hold the block: the largest plate that fits and where, as one more hint; empty where none
    does."""
    stock = setup.stock
    arm = setup.cell.arm(str(stock.held_by))
    wires = _wires(setup, part)
    best = _largest(stock, wires, margin)
    if best is None:
        return "no gripper of 20 mm or more fits below the part"
    size, at, turn = best
    width, depth = (round(v / MM) for v in size)
    turned = f", turned by {turn / DEG:g} deg" if turn else ""
    where = f"[{at[0] / MM + 0.0:g}, {at[1] / MM + 0.0:g}] mm{turned}"
    plate = gripper_plate(*size)
    told = f"the largest plate that fits has width_mm: {width}, depth_mm: {depth}, with its middle at {where}"
    if not can_hold(plate, stock, arm.data.payload):
        needed = GRIP_FORCE_FACTOR * (stock.mass or 0.0) * GRAVITY
        return f"{told}; it holds with {plate.holding:.0f} N, {needed:.0f} N are needed"
    return f"{told}; list it in the cell's grippers, or mount it, and leave grip out: Tandem finds it"


def advised(problem: Problem, found: Sequence[Issue]) -> list[Issue]:
    """The issues of a problem that is read, those of grips with what would hold the block."""
    out = []
    for issue in found:
        setup = next((s for s in problem.setups if _of(s, issue)), None)
        if setup is not None:
            hint = advice(setup, problem.part, _margin(problem, setup))
            issue = dataclasses.replace(issue, hint=hint)
        out.append(issue)
    return out


def _of(setup: Setup, issue: Issue) -> bool:
    field = f"operations.{setup.operations[0]}.setup" if setup.number > 1 else "stock"
    return issue.code in ("stock.footprint", "stock.grip_force") and (issue.field or "").startswith(field)


@dataclasses.dataclass(frozen=True)
class Wires:
    """The ruled ``surfaces`` along which wires run beyond the block, whose bottom face is at z = ``floor``
    [m]; ``parts``: outlines there of what stays held, and the ``middle`` of it."""

    surfaces: tuple[Ruled, ...]
    floor: float
    parts: BaseGeometry | None
    middle: tuple[float, float]
    known: dict[float, FloatArray] = dataclasses.field(default_factory=dict)

    def at(self, below: float) -> FloatArray:
        """Pieces (K, 2, 2) [m] of the curves in which they cross a level ``below`` [m] the bottom face."""
        level = round(self.floor - below, 6)
        if level not in self.known:
            self.known[level] = _crossings(self.surfaces, level)
        return self.known[level]


def _margin(problem: Problem, setup: Setup) -> float:
    """The largest margin that operations of a setup state [m]."""
    stated = [getattr(problem.operations[i], "margin_mm", None) for i in setup.operations]
    return max((float(v) * MM for v in stated if v is not None), default=WIRE_MARGIN)


def _wires(setup: Setup, part: Part | None) -> Wires:
    """The rulings of all surfaces of the part, made as long as it takes."""
    stock = setup.stock
    floor = float(stock.lower[2])
    surfaces = () if part is None else part.ruled
    outlines = [_outline(one, floor) for one in surfaces if one.closed and not one.hole]
    whole = [one for one in outlines if one is not None and one.area > 0.0]
    parts = shapely.unary_union(whole) if whole else None
    centre = (0.5 * (stock.lower + stock.upper))[:2] if parts is None else np.array(parts.centroid.coords[0])
    return Wires(surfaces, floor, parts, (float(centre[0]), float(centre[1])))


def _crossings(surfaces: Sequence[Ruled], level: float) -> FloatArray:
    """Pieces (K, 2, 2) [m] of the curves in which rulings cross the plane z = ``level``."""
    pieces = [np.zeros((0, 2, 2))]
    for one in surfaces:
        points = _at_level(one, level)
        ends = np.stack([points, np.roll(points, -1, axis=0)], axis=1)
        pieces.append(ends if one.closed else ends[:-1])
    every = np.concatenate(pieces)
    return every[np.isfinite(every).all(axis=(1, 2))]


def _at_level(one: Ruled, level: float) -> FloatArray:
    """Points (M', 2) [m] at which rulings, and others between them, cross z = ``level``, NaN if level."""
    start, end = one.start, one.end
    if one.closed:
        start, end = np.concatenate([start, start[:1]]), np.concatenate([end, end[:1]])
    way = np.maximum(
        np.linalg.norm(np.diff(start, axis=0), axis=1), np.linalg.norm(np.diff(end, axis=0), axis=1)
    )
    count = np.clip(np.ceil(way / RULING_SPACING), 1, 400).astype(int)
    at = np.concatenate([k + np.arange(n) / n for k, n in enumerate(count)])
    at = at if one.closed else np.append(at, len(start) - 1.0)
    k = np.minimum(at.astype(int), len(start) - 2)
    share = (at - k)[:, None]
    first = start[k] + share * (start[k + 1] - start[k])
    last = end[k] + share * (end[k + 1] - end[k])
    rise = last[:, 2] - first[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.where(np.abs(rise) > 1e-9, (level - first[:, 2]) / rise, np.nan)
    return np.asarray(first[:, :2] + along[:, None] * (last - first)[:, :2])


def _outline(one: Ruled, level: float) -> Polygon | None:
    points = _at_level(one, level)
    points = points[np.isfinite(points).all(axis=1)]
    return shapely.make_valid(Polygon(points)) if len(points) > 2 else None


def _shapes(tool: Gripper) -> list[tuple[FloatArray, tuple[float, float]]]:
    """Half the width and depth (2,) [m] of what a gripper consists of, and from where to where below its
    face it goes."""
    out = []
    for shape in tool.shapes:
        points = transform(inverse(tool.tcp) @ shape.pose, corners(shape))
        low, high = points.min(axis=0), points.max(axis=0)
        out.append((np.maximum(np.abs(low[:2]), np.abs(high[:2])), (-float(high[2]), -float(low[2]))))
    return out


def _free(tool: Gripper, turn: float, stock: Stock, wires: Wires, margin: float) -> BaseGeometry:
    """Where the middle of a gripper's face may be on the block's bottom face."""
    half = 0.5 * np.array(tool.footprint if turn == 0.0 else tool.footprint[::-1])
    low, high = stock.lower[:2] + half, stock.upper[:2] - half
    if (high < low - 1e-9).any():
        return Polygon()
    free: BaseGeometry = box(*(low - 1e-9), *(high + 1e-9))
    if wires.parts is not None:
        free = free.intersection(wires.parts)
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=2)))
    blocked = []
    for own, levels in _shapes(tool):
        around = signs * ((own if turn == 0.0 else own[::-1]) + margin + WIRE_SPARE)
        for below in levels:
            points = (wires.at(below)[:, :, None] + around).reshape(-1, 8, 2)
            blocked += list(shapely.convex_hull(shapely.multipoints(points)))
    return free.difference(shapely.unary_union(blocked)) if blocked else free


def _place(
    tool: Gripper, turn: float, stock: Stock, wires: Wires, margin: float
) -> tuple[float, float] | None:
    """A round point of where its face may be, the nearest to the middle of the part."""
    free = _free(tool, turn, stock, wires, margin)
    if free.is_empty:
        return None
    low, high = np.array(free.bounds).reshape(2, 2)
    for step in (GRIP_POINT_STEP, 1.0 * MM):
        axes = [
            np.arange(np.ceil(a / step), np.floor(b / step) + 1) * step
            for a, b in zip(low, high, strict=True)
        ]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        points = points[shapely.intersects_xy(free, points)] if len(points) else points
        if len(points):
            best = points[int(np.argmin(np.linalg.norm(points - wires.middle, axis=1)))]
            return float(round(best[0], 9)), float(round(best[1], 9))
    return None


def _largest(
    stock: Stock, wires: Wires, margin: float
) -> tuple[tuple[float, float], tuple[float, float], float] | None:
    """About the largest plate that fits, in steps of `PLATE_STEP`, with its middle and turn."""
    neck = _free(gripper_plate(2.0 * PLATE_STEP, 2.0 * PLATE_STEP), 0.0, stock, wires, margin)
    if neck.is_empty:
        return None
    low, high = np.array(neck.bounds).reshape(2, 2)
    axes = [
        np.arange(np.ceil(a / GRIP_POINT_STEP), np.floor(b / GRIP_POINT_STEP) + 1) * GRIP_POINT_STEP
        for a, b in zip(low, high, strict=True)
    ]
    middles = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    middles = middles[shapely.intersects_xy(neck, middles)] if len(middles) else middles
    room = np.minimum(stock.upper[:2] - middles, middles - stock.lower[:2])
    near = np.concatenate([wires.at(0.0).mean(axis=1), wires.at(FACE_THICKNESS).mean(axis=1)])
    away = np.abs(middles[:, None] - near) - margin - WIRE_SPARE - 0.5 * RULING_SPACING
    sizes: list[tuple[float, float]] = []
    for depth in np.arange(2, int(2.0 * max(room[:, 1], default=0.0) / PLATE_STEP) + 1) * PLATE_STEP:
        beside = np.where(away[..., 1] < 0.5 * depth, away[..., 0], np.inf).min(axis=1, initial=np.inf)
        half = np.where(room[:, 1] >= 0.5 * depth - 1e-9, np.minimum(beside, room[:, 0]), 0.0)
        width = float(np.floor(2.0 * half.max() / PLATE_STEP + 1e-6) * PLATE_STEP)
        sizes += [(min(width, 2.0), float(depth))] if width >= 2.0 * PLATE_STEP else []
    for size in sorted(sizes, key=lambda one: -one[0] * one[1]):
        at = _place(gripper_plate(*size), 0.0, stock, wires, margin)
        if at is not None:
            return size, at, 0.0
    return None
