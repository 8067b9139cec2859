"""What cuts a sheet, as the job sees it: a torch whose TCP is on the face, a mill or a knife that goes
through it."""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.swept_body import RoundBody
from planner.geometry.units import MM
from planner.issues import refusal
from planner.processes.trim.plan.operation import KnifeCut, MillCut, Trim
from planner.tooling import Blade, Cutter, Knife, Mill, Tool, Torch

Trimmer = Torch | Mill | Knife
"""Tools that trim."""

OFF_SHANK: Final = 0.1 * MM
"""How much of flute or blade [m] stays out of the sheet besides the wanted clearance."""


@dataclasses.dataclass(frozen=True)
class Cutting:
    """``word`` names the tool, ``kerf`` [m] is the width of its slot. In a slot its TCP is ``deep`` [m]
    behind the face, along its axis, and where it begins ``lift`` [m] higher than that. ``body`` keeps clear
    of the sheet. A mill's ``cutter`` cuts what it meets, a knife's ``blade`` what is in its plane; both go
    down at ``plunge`` [m/s], straight where not ``ramp``."""

    word: str
    kerf: float
    deep: float
    lift: float
    body: RoundBody
    cutter: Cutter | None = None
    plunge: float = float("inf")
    ramp: bool = True
    blade: Blade | None = None

    @property
    def through(self) -> bool:
        """Whether it goes through the sheet."""
        return self.cutter is not None or self.blade is not None


def kerf_of(tool: Trimmer) -> float:
    """Width [m] of the slot that a tool cuts; a knife takes nothing away."""
    match tool:
        case Torch():
            return tool.kerf
        case Mill():
            return 2.0 * tool.cutter.radius
        case Knife():
            return 0.0


def mounted(op: Trim, tool: Tool) -> Trimmer:
    """The tool with which an arm cuts. Raises ``TandemError`` (trim.tool) for one that does not."""
    if isinstance(tool, Mill | Torch | Knife) and op.by.kind == _KIND[type(tool)]:
        return tool
    wanted = op.by.kind
    what = f"{op.name}: arm {op.arms[0]} carries {tool.name}, no {wanted}"
    hint = f"give it tool: {{kind: {wanted}, ...}}, by a setup if need be"
    if isinstance(tool, Mill | Torch | Knife):
        hint += f", or state by: {{kind: {_KIND[type(tool)]}}}"
    raise refusal("trim.tool", what, hint=hint)


_KIND: Final = {Mill: "mill", Torch: "torch", Knife: "knife"}
"""What ``by`` calls each tool."""


def cutting(op: Trim, tool: Trimmer, thickness: float) -> Cutting:
    """How a tool cuts a sheet ``thickness`` [m] thick. Raises ``TandemError`` (trim.tool) for cutters and
    blades that do not go through it."""
    if isinstance(tool, Torch):
        height = tool.standoff if op.pierce.height_mm is None else op.pierce.height_mm * MM
        return Cutting("torch", tool.kerf, 0.0, height - tool.standoff, torch_body(tool))
    if isinstance(tool, Knife) and isinstance(op.by, KnifeCut):
        deep = thickness + op.by.below_mm * MM
        _require_reach(op, ("blade", "blade_mm"), tool.blade.length, deep)
        body = _cylinders([(tool.blade.length, tool.back, tool.body)])
        lift, plunge = deep + op.by.start_mm * MM, op.by.plunge_mm_s * MM
        return Cutting("knife", 0.0, deep, lift, body, plunge=plunge, ramp=False, blade=tool.blade)
    if not isinstance(tool, Mill) or not isinstance(op.by, MillCut):
        raise ValueError("a mill cuts by: {kind: mill}, a knife by: {kind: knife}")
    cutter, by = tool.cutter, op.by
    deep = thickness + by.below_mm * MM
    _require_reach(op, ("flute", "flute_mm"), cutter.flute, deep)
    if cutter.corner > by.below_mm * MM:
        what = f"{op.name}: the end of the {cutter.kind} cutter, round over {cutter.corner / MM:g} mm, stays "
        what += f"in the sheet; below_mm: {by.below_mm:g}"
        hint = f"take a cylinder, or below_mm: {cutter.corner / MM:g}"
        raise refusal("trim.tool", what, limit=by.below_mm, unit="mm", hint=hint)
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


def _require_reach(op: Trim, names: tuple[str, str], length: float, deep: float) -> None:
    """Whether what cuts reaches ``deep`` [m] behind the face with room for what does not; ``names``: of it,
    and of the field of its ``length`` [m]."""
    least = deep + op.clear_mm * MM + OFF_SHANK
    if length < least:
        what = f"{op.name}: the {names[0]} of {length / MM:g} mm does not reach through the sheet; wanted: "
        what += f"{least / MM:.2f} mm, the sheet, below_mm and clear_mm"
        hint = f"take a longer {names[1]}, or less below_mm"
        value, limit = length / MM, least / MM
        raise refusal("trim.tool", what, value=value, limit=limit, unit="mm", hint=hint)


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
