"""Tools on flanges: a sum type of their kinds, and what makes each of them from sizes."""

from typing import assert_never

from planner.geometry.arrays import Shape
from planner.tooling.holding_tools import (
    BOW_SPAN,
    BOW_THROAT,
    BOW_WIRE_DIAMETER,
    GRIPPER_REACH,
    REACH,
    Bow,
    Gripper,
    PlainTool,
    WireHolder,
    bow,
    gripper_plate,
    plain,
    vacuum_cup,
    wire_holder,
)
from planner.tooling.knife import KNIFE_BODY, Blade, Knife, knife
from planner.tooling.torch import TORCH_SIZE, Torch, TorchKind, torch
from planner.tooling.working_tools import (
    DISK_RIM,
    MILL_HOLDER,
    MILL_SPINDLE,
    Cutter,
    CutterKind,
    FormingHead,
    FormingTool,
    Mill,
    ball_tool,
    disk_tool,
    heat_tool,
    mill,
    profile,
)

Tool = WireHolder | Bow | Gripper | FormingTool | Mill | Torch | Knife | PlainTool
"""A tool on a flange: one of these kinds, each with what it really has."""


def working_solid(tool: Tool) -> Shape | None:
    """The solid, in the flange frame, with which a tool works the stock: the wire of a bow, the head of a
    forming tool, a mill's cutter, a torch with its nozzle, a knife's blade; it alone may touch the stock, in
    segments that work it. None for tools that work with nothing rigid of their own."""
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
    "DISK_RIM",
    "GRIPPER_REACH",
    "KNIFE_BODY",
    "MILL_HOLDER",
    "MILL_SPINDLE",
    "REACH",
    "TORCH_SIZE",
    "Blade",
    "Bow",
    "Cutter",
    "CutterKind",
    "FormingHead",
    "FormingTool",
    "Gripper",
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
    "heat_tool",
    "knife",
    "mill",
    "plain",
    "profile",
    "torch",
    "vacuum_cup",
    "wire_holder",
    "working_solid",
]
