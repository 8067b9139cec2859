"""Tools on flanges: a sum type of their kinds, and functions that make each of them from sizes."""

from typing import assert_never

from planner.geometry.arrays import Shape
from planner.tooling.holding_tools import (
    BOW_SPAN,
    BOW_THROAT,
    BOW_WIRE_DIAMETER,
    GRIPPER_REACH,
    HOLDER_REACH_M,
    Bow,
    Gripper,
    HolderBody,
    PlainTool,
    WireHolder,
    bow,
    gripper_plate,
    plain_tool,
    vacuum_cup,
    wire_holder,
)
from planner.tooling.knife import KNIFE_BODY, Blade, Knife, knife
from planner.tooling.torch import TORCH_SIZE, Torch, TorchKind, torch
from planner.tooling.working_tools import (
    DISK_RIM_M,
    MILL_HOLDER,
    MILL_SPINDLE,
    Cutter,
    CutterGeometry,
    CutterKind,
    FormingHead,
    FormingTool,
    Mill,
    ball_tool,
    disk_tool,
    head_outline,
    heat_tool,
    mill,
)

Tool = WireHolder | Bow | Gripper | FormingTool | Mill | Torch | Knife | PlainTool
"""A tool on a flange: one of these kinds, each with its own properties."""


def working_solid(tool: Tool) -> Shape | None:
    """Return the solid, in the flange frame, with which a tool works the stock.

    It is the wire of a bow, the head of a forming tool, a mill's cutter, a torch with its nozzle, or a
    knife's blade. No other solid of the tool may touch the stock, and this one only in the segments that
    work it. The result is None for tools that have no such rigid solid.
    """
    match tool:
        case Bow():
            return tool.wire
        case FormingTool() | Mill() | Torch() | Knife():
            return tool.solid
        case WireHolder() | Gripper() | PlainTool():
            return None
        case _:
            assert_never(tool)


__all__ = [
    "BOW_SPAN",
    "BOW_THROAT",
    "BOW_WIRE_DIAMETER",
    "DISK_RIM_M",
    "GRIPPER_REACH",
    "HOLDER_REACH_M",
    "KNIFE_BODY",
    "MILL_HOLDER",
    "MILL_SPINDLE",
    "TORCH_SIZE",
    "Blade",
    "Bow",
    "Cutter",
    "CutterGeometry",
    "CutterKind",
    "FormingHead",
    "FormingTool",
    "Gripper",
    "HolderBody",
    "Knife",
    "Mill",
    "PlainTool",
    "Tool",
    "Torch",
    "TorchKind",
    "WireHolder",
    "ball_tool",
    "bow",
    "disk_tool",
    "gripper_plate",
    "head_outline",
    "heat_tool",
    "knife",
    "mill",
    "plain_tool",
    "torch",
    "vacuum_cup",
    "wire_holder",
    "working_solid",
]
