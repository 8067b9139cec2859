"""The parts of trimming tools that cut, and the parts that keep clear of the sheet, as planning uses them.

The TCP of a torch is on the face. A mill or knife goes through the sheet.
"""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.swept_body import RoundBody
from planner.geometry.units import MM
from planner.issues import issue_error
from planner.processes.trim.plan.operation import KnifeCut, MillCut, Trim
from planner.tooling import Blade, Cutter, Knife, Mill, Tool, Torch

TrimTool = Torch | Mill | Knife
"""Tools that trim."""

SHANK_MARGIN_M: Final = 0.1 * MM
"""Length of flute or blade [m] that stays out of the sheet, in addition to the required clearance."""


@dataclasses.dataclass(frozen=True)
class CuttingTool:
    """How a tool cuts.

    Attributes:
        label: Name of the tool in messages.
        kerf: Width of its slot [m].
        depth: Depth of the TCP behind the face in a slot, along the tool's axis [m].
        lift: Height of the TCP above its height in the slot where a slot starts [m].
        clear_body: Part of the tool that keeps clear of the sheet.
        cutter: Cutter of a mill, None for other tools.
        plunge: Speed at which a mill or knife goes down [m/s], infinite for a torch.
        is_ramp: Whether it goes down along its lead-in, otherwise straight down.
        blade: Blade of a knife, None for other tools.
    """

    label: str
    kerf: float
    depth: float
    lift: float
    clear_body: RoundBody
    cutter: Cutter | None = None
    plunge: float = float("inf")
    is_ramp: bool = True
    blade: Blade | None = None

    @property
    def goes_through(self) -> bool:
        """Whether it goes through the sheet."""
        return self.cutter is not None or self.blade is not None


def kerf_width(tool: TrimTool) -> float:
    """Return the width [m] of the slot that a tool cuts. A knife removes nothing."""
    match tool:
        case Torch():
            return tool.kerf
        case Mill():
            return 2.0 * tool.cutter.radius
        case Knife():
            return 0.0


def mounted_tool(op: Trim, tool: Tool) -> TrimTool:
    """Return the tool with which an arm cuts.

    Args:
        op: Operation.
        tool: Tool of the arm.

    Raises:
        TandemError: ``trim.tool`` if it does not cut as the operation states.
    """
    if isinstance(tool, Mill | Torch | Knife) and op.by.kind == _TOOL_KINDS[type(tool)]:
        return tool
    required = op.by.kind
    message = f"{op.name}: arm {op.arms[0]} carries {tool.name}, which is not a {required}"
    hint = f"give it tool: {{kind: {required}, ...}}, in a setup if necessary"
    if isinstance(tool, Mill | Torch | Knife):
        hint += f", or state by: {{kind: {_TOOL_KINDS[type(tool)]}}}"
    raise issue_error("trim.tool", message, hint=hint)


_TOOL_KINDS: Final = {Mill: "mill", Torch: "torch", Knife: "knife"}
"""Kind of each tool in ``by``."""


def cutting_tool(op: Trim, tool: TrimTool, thickness: float) -> CuttingTool:
    """Return how a tool cuts a sheet: its kerf, depth, lift, and the part that keeps clear of the sheet.

    Args:
        op: Operation.
        tool: Tool of the arm.
        thickness: Thickness of the sheet [m].

    Raises:
        TandemError: ``trim.tool`` if a flute or blade is too short to go through the sheet, or if the rounded
            end of a cutter stays in the sheet.
        ValueError: The operation states how another kind of tool cuts.
    """
    if isinstance(tool, Torch):
        height = tool.standoff if op.pierce.height_mm is None else op.pierce.height_mm * MM
        return CuttingTool("torch", tool.kerf, 0.0, height - tool.standoff, torch_body(tool))
    if isinstance(tool, Knife) and isinstance(op.by, KnifeCut):
        depth = thickness + op.by.below_mm * MM
        _require_reach(op, ("blade", "blade_mm"), tool.blade.length, depth)
        body = _stacked_cylinders([(tool.blade.length, tool.back, tool.body)])
        lift, plunge = depth + op.by.start_mm * MM, op.by.plunge_mm_s * MM
        return CuttingTool("knife", 0.0, depth, lift, body, plunge=plunge, is_ramp=False, blade=tool.blade)
    if not isinstance(tool, Mill) or not isinstance(op.by, MillCut):
        raise ValueError("a mill cuts by: {kind: mill}, a knife by: {kind: knife}")
    cutter, by = tool.cutter, op.by
    depth = thickness + by.below_mm * MM
    _require_reach(op, ("flute", "flute_mm"), cutter.flute, depth)
    if cutter.corner > by.below_mm * MM:
        message = (
            f"{op.name}: the end of the {cutter.kind} cutter, round over {cutter.corner / MM:g} mm, stays "
        )
        message += f"in the sheet with below_mm: {by.below_mm:g}"
        hint = f"use a cylinder, or below_mm: {cutter.corner / MM:g}"
        raise issue_error("trim.tool", message, limit=by.below_mm, unit="mm", hint=hint)
    return CuttingTool(
        "cutter",
        2.0 * cutter.radius,
        depth,
        depth + by.start_mm * MM,
        shank_body(cutter),
        cutter,
        by.plunge_mm_s * MM,
        by.entry == "ramp",
    )


def _require_reach(op: Trim, names: tuple[str, str], length: float, depth: float) -> None:
    """Check that a cutting part is long enough for the rest of the tool to stay clear of the sheet.

    ``names`` are those of the part and of the field with its ``length`` [m]; ``depth`` [m] is that of the tip
    behind the face.
    """
    required = depth + op.clear_mm * MM + SHANK_MARGIN_M
    if length < required:
        message = (
            f"{op.name}: the {names[0]} of {length / MM:g} mm does not reach through the sheet, required "
        )
        message += f"{required / MM:.2f} mm (sheet, below_mm and clear_mm)"
        hint = f"use a longer {names[1]}, or less below_mm"
        value, limit = length / MM, required / MM
        raise issue_error("trim.tool", message, value=value, limit=limit, unit="mm", hint=hint)


def torch_body(torch: Torch) -> RoundBody:
    """Return a torch as a body of revolution about its axis, from the TCP backwards.

    Distances are those from the planes of nozzle, cone and body, which are never more than the true ones.
    """
    slope = np.arctan2(torch.body - torch.nozzle, torch.cone)

    def distance(axial: FloatArray, radial: FloatArray) -> FloatArray:
        cone = (radial - torch.nozzle) * np.cos(slope) - (axial - torch.standoff) * np.sin(slope)
        ends = np.maximum(torch.standoff - axial, axial - torch.back)
        return np.asarray(np.maximum(np.maximum(cone, radial - torch.body), ends))

    return RoundBody(torch.standoff, torch.back, torch.body, distance)


def flute_body(cutter: Cutter) -> RoundBody:
    """Return the part of a mill that cuts: a cylinder."""
    return _stacked_cylinders([(0.0, cutter.flute, cutter.radius)])


def shank_body(cutter: Cutter) -> RoundBody:
    """Return the part of a mill that does not cut: shank, holder and spindle, as consecutive cylinders."""
    rings = cutter.holder_outline
    pieces = [(cutter.flute, cutter.overhang, cutter.shank)]
    pieces += [(float(a[0]), float(b[0]), float(a[1])) for a, b in zip(rings[::2], rings[1::2], strict=True)]
    return _stacked_cylinders(pieces)


def _stacked_cylinders(pieces: Sequence[tuple[float, float, float]]) -> RoundBody:
    """Return consecutive cylinders, each with start and end behind the tip and radius [m].

    Distances are those from their planes and sides, which are never more than the true ones.
    """

    def distance(axial: FloatArray, radial: FloatArray) -> FloatArray:
        distances = [np.maximum(radial - r, np.maximum(low - axial, axial - high)) for low, high, r in pieces]
        return np.asarray(np.min(distances, axis=0))

    widest = max(radius for _, _, radius in pieces)
    return RoundBody(pieces[0][0], pieces[-1][1], widest, distance)
