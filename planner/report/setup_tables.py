"""Tables of the setup sheet that hold for a whole setup: tools, block, and points to measure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner import catalogue
from planner.cell import standing as standing_on
from planner.claims import HoldsStock
from planner.geometry.rigid import to_quaternion, to_rpy
from planner.plans import Plan
from planner.problem import Setup, Stock
from planner.report import markup, standing
from planner.report.markup import Raw
from planner.tooling import Gripper
from planner.units import DEG, MM

FloatArray = NDArray[np.float64]
_FILL = Raw('<span class="fill"></span>')
_POSE = ("x, y, z [mm]", "roll, pitch, yaw [deg]", "quaternion w, x, y, z")
_CORNERS = (
    ("bottom corner −x −y", (0, 0, 0)),
    ("bottom corner +x −y", (1, 0, 0)),
    ("bottom corner −x +y", (0, 1, 0)),
    ("top corner −x −y", (0, 0, 1)),
)


def pose_cells(pose: FloatArray) -> tuple[Raw, Raw, Raw]:
    """Position [mm], roll-pitch-yaw [deg] and quaternion of a pose (4, 4) as text."""
    turn = ", ".join(markup.fixed(float(v) / DEG, 3) for v in to_rpy(pose[:3, :3]))
    quaternion = ", ".join(markup.fixed(float(v), 6) for v in to_quaternion(pose[:3, :3]))
    return _point(pose[:3, 3]), Raw(turn), Raw(quaternion)


def tools(setup: Setup, plan: Plan) -> Raw:
    """What each arm carries, its TCP on the flange and its base in the world."""
    rows, frames = [], []
    for arm in setup.cell.arms:
        robot = catalogue.robot(arm.robot)
        cog = ", ".join(markup.fixed(float(v) / MM, 1) for v in arm.tool.cog)
        rows.append((arm.name, robot.title, robot.controller, arm.tool.name, arm.tool.mass, Raw(cog)))
        base = np.asarray(plan.bases.get(arm.name, arm.base))
        frames.append((f"{arm.name}: TCP on the flange", *pose_cells(arm.tool.tcp)))
        frames.append((f"{arm.name}: base in the world", *pose_cells(base)))
    heads = ("arm", "robot", "controller", "tool", "mass [kg]", "centre of gravity on the flange [mm]")
    return Raw(markup.table(heads, rows) + markup.table(("frame", *_POSE), frames))


def block(setup: Setup, plan: Plan, held: HoldsStock | None) -> Raw:
    """Size and place of the block as found, and how an arm holds it."""
    stock = setup.stock
    found = stock.upper - stock.lower
    place, turn, quaternion = pose_cells(np.asarray(plan.places[setup.number - 1]))
    items: list[tuple[object, object]] = [("size x × y × z [mm]", _size(found))]
    if stock.oversize.any():
        items.append(("of it the datum block [mm]", _size(stock.size)))
        sides = "; ".join(
            f"{axis} {markup.fixed(low / MM, 1)} and {markup.fixed(high / MM, 1)}"
            for axis, low, high in zip("xyz", *stock.oversize.tolist(), strict=True)
        )
        items.append(("to be trimmed below and above [mm]", Raw(sides)))
    items.append(("frame", "centre of the datum block's bottom face, z up through the block"))
    if stock.foam is not None:
        items.append(("foam", f"{stock.foam.title}, {stock.foam.density:g} kg/m³"))
    if stock.mass is not None:
        items.append(("mass", Raw(f"{markup.fixed(stock.mass, 3)} kg")))
    if stock.held_by is not None:
        tool = setup.cell.arm(stock.held_by).tool
        at, lean, quaternion_grip = pose_cells(stock.grip)
        items.append(("held by", f"{tool.name} of arm {stock.held_by}, by its bottom face"))
        items += [
            ("grip: the block's frame in the gripper's TCP frame x, y, z [mm]", at),
            ("grip: roll, pitch, yaw [deg]", lean),
            ("grip: quaternion w, x, y, z", quaternion_grip),
        ]
        if isinstance(tool, Gripper):
            width, depth = (markup.fixed(v / MM, 0) for v in tool.footprint)
            items.append(("face of the gripper, centred on its TCP [mm]", Raw(f"{width} × {depth}")))
            items += _clamped_by(setup.stock)
        if held is not None:
            items.append(
                (
                    "load told to the controller",
                    Raw(f"{markup.fixed(held.mass, 3)} kg at {_point(held.cog)} mm"),
                )
            )
    name = "place: x, y, z in the world [mm]"
    if stock.held_by is not None:
        name = "place about which it is moved: x, y, z in the world [mm]"
    if stock.held_by is None and stock.sheet is None:
        items.append(
            ("stands on", standing_on.told(setup.cell, stock, np.asarray(plan.places[setup.number - 1])))
        )
        items += _from_bases(setup, plan)
    chosen = "the problem" if stock.place is not None else "the placement search"
    items += [
        (name, place),
        ("place: roll, pitch, yaw [deg]", turn),
        ("place: quaternion w, x, y, z", quaternion),
        ("place chosen by", chosen),
    ]
    return markup.facts(items)


def _from_bases(setup: Setup, plan: Plan) -> list[tuple[object, object]]:
    """Where the block is from the base of each arm: one bottom corner, its edges, its underside."""
    stock, place = setup.stock, np.asarray(plan.places[setup.number - 1])
    out: list[tuple[object, object]] = []
    for arm in setup.cell.arms:
        base = np.asarray(plan.bases.get(arm.name, arm.base))
        seen = np.linalg.inv(base) @ place
        corner = (seen @ np.append(stock.lower, 1.0))[:3]
        along = seen[:2, 0] if np.linalg.norm(seen[:2, 0]) > 0.5 else seen[:2, 1]
        turn = float(np.arctan2(along[1], along[0])) / DEG
        off = abs((turn + 45.0) % 90.0 - 45.0)
        edges = (
            "edges parallel to the base" if off < 0.005 else f"edges turned by {markup.fixed(turn, 2)} deg"
        )
        out.append((f"from the base of {arm.name}: corner −x −y −z [mm]", Raw(f"{_point(corner)}; {edges}")))
    return out


def _clamped_by(stock: Stock) -> list[tuple[object, object]]:
    """Where the middle of a gripper is, from two edges of the block's bottom face."""
    middle = np.linalg.inv(stock.grip)
    across = middle[:2, 3] - stock.lower[:2]
    turn = float(np.arctan2(middle[1, 0], middle[0, 0])) / DEG
    turned = "its sides along the block's" if abs(turn) < 1e-6 else f"turned by {markup.fixed(turn, 1)} deg"
    x, y = (markup.fixed(float(v) / MM, 1) for v in across)
    edges = f"{x} mm from edge −x, {y} mm from edge −y"
    by = "Tandem" if stock.grip_chosen else "the problem"
    return [
        ("middle of the gripper on the block's bottom face", Raw(f"{edges}; {turned}")),
        ("grip chosen by", by),
    ]


def measure(setup: Setup, plan: Plan, operation: int) -> Raw:
    """TCPs at the first target of an operation and corners of the block, with room for what was measured."""
    rows = []
    made = plan.operations[operation]
    for arm in setup.cell.arms:
        if arm.name not in made.q:
            continue
        q = made.q[arm.name][0]
        angles = ", ".join(
            markup.fixed(float(v) / DEG, 3) for v in catalogue.robot(arm.robot).to_controller(q)
        )
        place, turn, _ = pose_cells(standing.flanges(arm, plan.bases, q) @ arm.tool.tcp)
        rows.append((f"{arm.name}: TCP at {made.targets.name(0)}, world", place, turn, Raw(angles), _FILL))
    stock = setup.stock
    ends = np.array([stock.lower, stock.upper])
    held = stock.held_by is not None
    frame = stock.grip if held else np.asarray(plan.places[setup.number - 1])
    where = f"TCP frame of {stock.held_by}" if held else "world"
    for label, (i, j, k) in _CORNERS:
        corner = np.array([ends[i, 0], ends[j, 1], ends[k, 2], 1.0])
        rows.append((f"block, {label}, {where}", _point((frame @ corner)[:3]), Raw(""), Raw(""), _FILL))
    heads = ("what", *_POSE[:2], "axes on the controller [deg]", "measured")
    return markup.table(heads, rows)


def _point(point: FloatArray) -> Raw:
    return Raw(", ".join(markup.fixed(float(v) / MM, 2) for v in point))


def _size(size: FloatArray) -> Raw:
    return Raw(" × ".join(markup.fixed(float(v) / MM, 1) for v in size))
