"""What cuts a sheet, as the job sees it: a torch whose TCP is on the face, or a mill that goes through it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.swept_body import RoundBody
from planner.geometry.units import MM
from planner.issues import Issue, TandemError
from planner.tooling import Cutter, Mill, Tool, Torch
from planner.trim.operation import MillCut, Trim

OFF_SHANK: Final = 0.1 * MM
"""How much of the flute [m] stays out of the sheet besides the wanted clearance."""


@dataclasses.dataclass(frozen=True)
class Cutting:
    """``word`` names the tool, ``kerf`` [m] is the width of its slot. In a slot its TCP is ``deep`` [m]
    behind the face, along its axis, and where it begins ``lift`` [m] higher than that. ``body`` keeps clear
    of the sheet. A mill's ``cutter`` cuts what it meets; it goes down at ``plunge`` [m/s], straight where not
    ``ramp``."""

    word: str
    kerf: float
    deep: float
    lift: float
    body: RoundBody
    cutter: Cutter | None = None
    plunge: float = float("inf")
    ramp: bool = True


def kerf_of(tool: Torch | Mill) -> float:
    """Width [m] of the slot that a tool cuts."""
    return tool.kerf if isinstance(tool, Torch) else 2.0 * tool.cutter.radius


def mounted(op: Trim, tool: Tool) -> Torch | Mill:
    """The tool with which an arm cuts. Raises ``TandemError`` (trim.tool) for one that does not."""
    if isinstance(op.by, MillCut) and isinstance(tool, Mill):
        return tool
    if not isinstance(op.by, MillCut) and isinstance(tool, Torch):
        return tool
    wanted = op.by.kind
    what = f"{op.name}: arm {op.arms[0]} carries {tool.name}, no {wanted}"
    hint = f"give it tool: {{kind: {wanted}, ...}}, by a setup if need be"
    if isinstance(tool, Mill):
        hint += ", or state by: {kind: mill}"
    raise TandemError(Issue("trim.tool", what, hint=hint))


def cutting(op: Trim, tool: Torch | Mill, thickness: float) -> Cutting:
    """How a tool cuts a sheet ``thickness`` [m] thick. Raises ``TandemError`` (trim.tool) for cutters that do
    not go through it."""
    if isinstance(tool, Torch):
        height = tool.standoff if op.pierce.height_mm is None else op.pierce.height_mm * MM
        return Cutting("torch", tool.kerf, 0.0, height - tool.standoff, torch_body(tool))
    if not isinstance(op.by, MillCut):
        raise ValueError("a mill cuts by: {kind: mill}")
    cutter, by = tool.cutter, op.by
    deep = thickness + by.below_mm * MM
    least = deep + op.clear_mm * MM + OFF_SHANK
    if cutter.flute < least:
        what = f"{op.name}: the flute of {cutter.flute / MM:g} mm does not reach through the sheet; wanted: "
        what += f"{least / MM:.2f} mm, the sheet, below_mm and clear_mm"
        hint = "take a longer flute_mm, or less below_mm"
        value, limit = cutter.flute / MM, least / MM
        raise TandemError(Issue("trim.tool", what, value=value, limit=limit, unit="mm", hint=hint))
    if cutter.corner > by.below_mm * MM:
        what = f"{op.name}: the end of the {cutter.kind} cutter, round over {cutter.corner / MM:g} mm, stays "
        what += f"in the sheet; below_mm: {by.below_mm:g}"
        hint = f"take a cylinder, or below_mm: {cutter.corner / MM:g}"
        raise TandemError(Issue("trim.tool", what, limit=by.below_mm, unit="mm", hint=hint))
    return Cutting(
        "cutter",
        2.0 * cutter.radius,
        deep,
        deep + by.start_mm * MM,
        shank_body(cutter),
        cutter,
        by.plunge_mm_s * MM,
        by.entry == "ramp",
    )


def torch_body(torch: Torch) -> RoundBody:
    """A torch as a body of revolution about its axis, from the TCP backwards. Its distances are those from
    the planes of nozzle's end, cone and body, never more than the true ones."""
    slope = np.arctan2(torch.body - torch.nozzle, torch.cone)

    def distance(back: FloatArray, beside: FloatArray) -> FloatArray:
        cone = (beside - torch.nozzle) * np.cos(slope) - (back - torch.standoff) * np.sin(slope)
        ends = np.maximum(torch.standoff - back, back - torch.back)
        return np.asarray(np.maximum(np.maximum(cone, beside - torch.body), ends))

    return RoundBody(torch.standoff, torch.back, torch.body, distance)


def flute_body(cutter: Cutter) -> RoundBody:
    """What of a mill cuts: a cylinder."""
    return _cylinders([(0.0, cutter.flute, cutter.radius)])


def shank_body(cutter: Cutter) -> RoundBody:
    """What of a mill does not cut: shank, holder and spindle, cylinders one behind the other."""
    rings = cutter.behind
    pieces = [(cutter.flute, cutter.overhang, cutter.shank)]
    pieces += [(float(a[0]), float(b[0]), float(a[1])) for a, b in zip(rings[::2], rings[1::2], strict=True)]
    return _cylinders(pieces)


def _cylinders(pieces: Sequence[tuple[float, float, float]]) -> RoundBody:
    """Cylinders one behind the other, from where to where behind the tip and of which radius [m] each. Their
    distances are those from their planes and sides, never more than the true ones."""

    def distance(back: FloatArray, beside: FloatArray) -> FloatArray:
        own = [np.maximum(beside - r, np.maximum(low - back, back - high)) for low, high, r in pieces]
        return np.asarray(np.min(own, axis=0))

    widest = max(radius for _, _, radius in pieces)
    return RoundBody(pieces[0][0], pieces[-1][1], widest, distance)
