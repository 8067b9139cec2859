"""Tools on flanges: a sum type of their kinds, and what makes each of them from sizes."""

from planner.tooling.base import PlainTool, plain
from planner.tooling.bows import Bow, bow
from planner.tooling.forming_tools import FormingTool, ball_tool, disk_tool, heat_tool
from planner.tooling.grippers import Gripper, gripper_plate, vacuum_cup
from planner.tooling.heads import Cutter, CutterKind, FormingHead, profile
from planner.tooling.holders import REACH, WireHolder, wire_holder
from planner.tooling.kinds import Tool, working_solid
from planner.tooling.mills import Mill, mill

__all__ = [
    "REACH",
    "Bow",
    "Cutter",
    "CutterKind",
    "FormingHead",
    "FormingTool",
    "Gripper",
    "Mill",
    "PlainTool",
    "Tool",
    "WireHolder",
    "ball_tool",
    "bow",
    "disk_tool",
    "gripper_plate",
    "heat_tool",
    "mill",
    "plain",
    "profile",
    "vacuum_cup",
    "wire_holder",
    "working_solid",
]
