"""The kinds of tools as one sum type, and what is asked of a tool whatever its kind."""

from __future__ import annotations

from typing import assert_never

from planner.geometry.shapes import Shape
from planner.tooling.base import PlainTool
from planner.tooling.bows import Bow
from planner.tooling.forming_tools import FormingTool
from planner.tooling.grippers import Gripper
from planner.tooling.holders import WireHolder
from planner.tooling.mills import Mill

Tool = WireHolder | Bow | Gripper | FormingTool | Mill | PlainTool
"""A tool on a flange: one of these kinds, each with what it really has."""


def working_solid(tool: Tool) -> Shape | None:
    """The solid, in the flange frame, with which a tool works the stock: the wire of a bow, the head of a
    forming tool, a mill's cutter; it alone may touch the stock, in segments that work it. None for tools that
    work with nothing rigid of their own."""
    match tool:
        case Bow():
            return tool.wire
        case FormingTool() | Mill():
            return tool.solid
        case WireHolder() | Gripper() | PlainTool():
            return None
        case _:
            assert_never(tool)
