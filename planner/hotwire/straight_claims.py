"""What must hold of a job with a straight wire, from the problem alone."""

from __future__ import annotations

from typing import Final

import numpy as np

from planner.claims import (
    Claim,
    ContactOnlyIn,
    CutsSurface,
    FeedWindow,
    FollowsRulings,
    HoldsStock,
    KerfCurve,
    KerfWithin,
    SlitAllowed,
    StraightWire,
)
from planner.geometry.rulings import tessellate
from planner.hotwire.straight_cut import Cut
from planner.hotwire.straight_operation import Straight
from planner.hotwire.straight_order import Wanted
from planner.problem import Ruled, Setup
from planner.tooling import Bow
from planner.units import MM

THROUGH: Final = 1e-5
"""[m] a way in that is in the part for less than this spares it."""
SURFACE_CHORD: Final = 2e-5
"""[m] the triangles of a wanted surface are as near to it as this."""


def claims(
    op: Straight,
    setup: Setup,
    bow: Bow,
    cuts: list[Wanted],
    kerf: KerfCurve,
    slits: tuple[SlitAllowed, ...] = (),
) -> tuple[Claim, ...]:
    """Claims on the bow, on each cut, on the contact and on the block's holder."""
    ends = np.array([[-0.5 * bow.span, 0.0, 0.0], [0.5 * bow.span, 0.0, 0.0]])
    out: list[Claim] = [
        StraightWire(op.arms[0], ends[0], ends[1], bow.radius, op.margin_mm * MM),
        ContactOnlyIn(("cut",), op.signal, op.heat_up_s),
    ]
    tolerance = op.shape_tol_mm * MM
    for cut in cuts:
        mesh = tessellate(cut.ruled, SURFACE_CHORD)
        out.append(CutsSurface(cut.segment, mesh.vertices, mesh.faces, kerf, tolerance, op.share))
        start, end = _closed(cut.ruled)
        out.append(FollowsRulings(cut.segment, start, end, kerf, tolerance))
        if op.power_w is not None:
            low, high = op.kerf_range_mm
            out.append(KerfWithin(cut.segment, kerf, low * MM, high * MM))
        feed = op.feed_min_mm_s * MM, op.feed(cut.cut)
        out += [FeedWindow(cut.segment.at(phase), *feed) for phase in ("", "in", "out")]
    stock = setup.stock
    if stock.held_by is not None and stock.mass is not None:
        middle = np.append(0.5 * (stock.lower + stock.upper), 1.0)
        out.append(HoldsStock(stock.held_by, stock.grip, stock.mass, (stock.grip @ middle)[:3]))
    return (*out, *slits)


def slits(cuts: list[Cut]) -> tuple[SlitAllowed, ...]:
    """The slits by which the wire comes through the part to what is closed, and leaves it again."""
    out = []
    for cut in cuts:
        if cut.start is None or cut.start.through <= THROUGH:
            continue
        way, own = cut.start.way, cut.wanted.segment
        for segment, line, on in (
            (own.at("in"), cut.into[[-1]], cut.on.lines[[0]]),
            (own.at("out"), cut.out[[0]], cut.on.lines[[-1]]),
        ):
            # the slit ends where the wire meets the surface
            start, end = (
                at[0] + ((to[0] - at[0]) @ way) * way
                for at, to in zip((line.start, line.end), (on.start, on.end), strict=True)
            )
            out.append(SlitAllowed(segment, start, end, way))
    return tuple(out)


def _closed(ruled: Ruled) -> tuple[np.ndarray, np.ndarray]:
    """Guide lines of a surface, those of a closed one ending where they begin."""
    if not ruled.closed:
        return ruled.start, ruled.end
    return np.concatenate([ruled.start, ruled.start[:1]]), np.concatenate([ruled.end, ruled.end[:1]])
