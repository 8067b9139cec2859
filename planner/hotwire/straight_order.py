"""What is cut, and in which order: ruled surfaces of the part and sides of the block, as rows of rulings."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.hotwire.straight_operation import SIDES, Straight, SurfaceCut, TrimCut
from planner.hotwire.straight_section import depths
from planner.issues import Issue, TandemError
from planner.problem import Part, Ruled, Setup, Stock
from planner.segments import Segment, clash
from planner.tooling import Bow
from planner.units import MM

FloatArray = NDArray[np.float64]

LEAST_OVERSIZE: Final = 1e-4
"""[m] a side that stands out by less has nothing that could be cut off."""


LEAD_ALONG: Final = 0.94
"""Largest cosine between a lead and the wire: one along the wire takes it nowhere."""


@dataclasses.dataclass(frozen=True)
class Wanted:
    """One surface to cut; ``name`` is that of its segment behind ``cut/``."""

    name: str
    ruled: Ruled
    cut: SurfaceCut | TrimCut

    @property
    def segment(self) -> Segment:
        """The segment of the targets on the surface; the ways in and out are its other phases."""
        return Segment("cut", self.name)


def wanted(op: Straight, setup: Setup, part: Part | None) -> list[Wanted]:
    """The surfaces to cut, in order. Raises ``TandemError``: part.missing_surface, straight.trim,
    straight.lead, problem.duplicate_name."""
    out = _listed(op, setup, part)
    both = clash(one.segment for one in out)
    if both is not None:
        what = (
            f"{op.name}: two surfaces are called {both[0].name!r} and {both[1].name!r}, which programs "
            "cannot tell apart; rename one"
        )
        raise TandemError(Issue("problem.duplicate_name", what, field="part"))
    return out


def _listed(op: Straight, setup: Setup, part: Part | None) -> list[Wanted]:
    ruled = () if part is None else part.ruled
    if op.cuts == "all":
        if not ruled:
            raise TandemError(_missing(op, "cuts: all ruled surfaces", ruled))
        up, depth = -setup.stock.gravity, depths(ruled)
        order = sorted(range(len(ruled)), key=lambda k: _rank(ruled[k], depth[k], up))
        return [Wanted(ruled[k].name, ruled[k], SurfaceCut(surface=ruled[k].name)) for k in order]
    known = {r.name: r for r in ruled}
    out: list[Wanted] = []
    issues: list[Issue] = []
    for cut in op.cuts:
        if isinstance(cut, TrimCut):
            for side in cut.trim:
                fault = _no_oversize(op, setup.stock, side)
                issues += fault
                if not fault:
                    out.append(Wanted(f"trim_{side}", _side(op, setup, side, cut), cut))
        elif cut.surface in known:
            issues += _along_the_wire(op, known[cut.surface], cut)
            out.append(Wanted(cut.surface, known[cut.surface], cut))
        else:
            issues.append(_missing(op, f"surface '{cut.surface}'", ruled))
    if issues:
        raise TandemError(issues)
    return out


def _rank(ruled: Ruled, depth: int, up: FloatArray) -> tuple[int, int, float]:
    """Holes and pieces in holes first, the inmost before what is around them; then strips, then outlines,
    upper ones first, since what is cut free rests on the rest. ``depth``: in how many others it lies."""
    middle = 0.5 * (ruled.start + ruled.end).mean(axis=0)
    kind = 0 if ruled.hole or depth else 2 if ruled.closed else 1
    return kind, -depth, float(-(middle @ up).round(6)) if ruled.closed and not ruled.hole else 0.0


def _missing(op: Straight, what: str, ruled: tuple[Ruled, ...]) -> Issue:
    have = ", ".join(r.name for r in ruled) or "none"
    return Issue(
        "part.missing_surface",
        f"{op.name}: {what} cannot be cut; ruled surfaces of the part: {have}; add it to the part or correct "
        "the name",
        field="part",
    )


def _along_the_wire(op: Straight, ruled: Ruled, cut: SurfaceCut) -> list[Issue]:
    """A lead that is given must take the wire across itself, at every ruling."""
    if isinstance(cut.lead, str):
        return []
    rulings = ruled.end - ruled.start
    rulings = rulings / np.maximum(np.linalg.norm(rulings, axis=1, keepdims=True), 1e-12)
    lead = np.array(cut.lead) / np.linalg.norm(cut.lead)
    along = float(np.abs(rulings @ lead).max())
    if along <= LEAD_ALONG:
        return []
    angle, least = (np.degrees(np.arccos(min(value, 1.0))) for value in (along, LEAD_ALONG))
    return [
        Issue(
            "straight.lead",
            f"{op.name}: lead {list(cut.lead)} of {cut.surface} is {angle:.0f} degrees off the wire; "
            f"{least:.0f} at least are wanted: give a direction across the wire, or auto",
            field=cut.surface,
        )
    ]


def _no_oversize(op: Straight, stock: Stock, side: str) -> list[Issue]:
    axis, end = SIDES[side]
    over = float(stock.oversize[end, axis])
    if over >= LEAST_OVERSIZE:
        return []
    return [
        Issue(
            "straight.trim",
            f"{op.name}: side {side} is to be trimmed, but the block stands out of the datum block by "
            f"{over / MM:g} mm there; give stock.oversize_mm, or leave the side out",
            field="stock.oversize_mm",
            value=over / MM,
            limit=LEAST_OVERSIZE / MM,
            unit="mm",
        )
    ]


def _side(op: Straight, setup: Setup, side: str, cut: TrimCut) -> Ruled:
    """A side of the datum block as two rulings, from the upper to the lower edge where it stands upright."""
    stock = setup.stock
    axis, end = SIDES[side]
    low, high = np.array([-0.5, -0.5, 0.0]) * stock.size, np.array([0.5, 0.5, 1.0]) * stock.size
    along = _along(op, setup, axis, cut)
    sweep = 3 - axis - along
    corner = np.zeros((2, 2, 3))  # ruling, end
    corner[..., axis] = (low, high)[end][axis]
    corner[:, 0, along], corner[:, 1, along] = low[along], high[along]
    first, last = (low[sweep], high[sweep])
    falling = stock.gravity[sweep] > 0.5
    first, last = (first, last) if falling or stock.gravity[sweep] > -0.5 else (last, first)
    corner[0, :, sweep], corner[1, :, sweep] = first, last
    normal = np.cross(corner[1, 0] - corner[0, 0], corner[0, 1] - corner[0, 0])
    if normal[axis] * (1.0 if end else -1.0) < 0.0:
        corner = corner[:, ::-1]
    return Ruled(f"trim_{side}", corner[:, 0], corner[:, 1], np.zeros(2, dtype=np.bool_))


def _along(op: Straight, setup: Setup, axis: int, cut: TrimCut) -> int:
    """The axis that the wire is parallel to: level rather than upright, then the shorter way through."""
    if cut.along != "auto":
        return "xyz".index(cut.along)
    length = setup.stock.upper - setup.stock.lower
    tool = setup.cell.arm(op.arms[0]).tool
    room = (tool.span if isinstance(tool, Bow) else np.inf) - 2.0 * op.margin_mm * MM
    level = np.abs(setup.stock.gravity) < 0.5
    choice = [k for k in range(3) if k != axis]
    return min(choice, key=lambda k: (length[k] > room, not level[k], length[k]))
