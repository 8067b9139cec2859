"""Ways in and out of a straight wire's cuts, as the text has them: where a slit lies that the wire makes on
its way to a contour, and how it compares with what the part makes necessary."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.claims import CutsSurface, LeadsFrom, SlitsAllowed
from planner.geometry.vectors import dots
from planner.segments import Segment
from planner.verify.context import Context
from planner.verify.slit_section import Section
from planner.verify.speed import local
from planner.verify.wire import Wire

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

LONGER: Final = 1.25
"""A slit may be longer in the part than the least that is found, by this factor."""
OF_CONTOUR: Final = 0.02
"""And by this share of the way around its contour: it begins at one of a few places."""
OF_BLOCK: Final = 0.0025
"""And by this share of the block's diagonal, for a cut whose last side, or turns, come out better."""
ROUNDED: Final = 1e-4
"""[m] what rounded targets may add to a slit's width and length."""


@dataclasses.dataclass(frozen=True)
class Way:
    """A way in or out: stations ``rows`` (N,), the wire beside the contour first of all, then away from it.

    ``foot`` and ``along`` (3,) are a place and the direction of that wire, ``away`` (3,) a unit vector
    across it to where the wire comes from, ``normal`` (3,) that of the plane of both. ``half`` [m] is half
    the widest slot in the foam."""

    rows: IntArray
    foot: FloatArray
    along: FloatArray
    away: FloatArray
    normal: FloatArray
    half: float

    def aside(self, points: FloatArray) -> FloatArray:
        """Distance (...,) [m] of points (..., 3) from the plane."""
        return np.asarray(np.abs((points - self.foot) @ self.normal))


@dataclasses.dataclass(frozen=True)
class Slit:
    """The slit to a contour that is cut in ``segment``: the way in and the way out, which is off the plane
    of the way in by ``apart`` [m] at most; ``used`` [m] of it is in the part.

    ``ends`` of both ways as they are seen in ``section``; ``tolerance`` [m] of the cut; ``lead`` (3,): where
    it has to come from.
    """

    segment: Segment
    into: Way
    out: Way
    apart: float
    used: float
    section: Section
    ends: tuple[tuple[FloatArray, FloatArray], ...]
    tolerance: float
    lead: FloatArray | None

    @property
    def along(self) -> float:
        """How far [m] it runs beside another contour, taking more than the tolerance from it, beyond what it
        takes to cross it, at most."""
        found = [
            self.section.beside(*ends, way.half, way.half - self.tolerance)
            for ends, way in zip(self.ends, self.ways, strict=True)
            if way.half > self.tolerance
        ]
        return max(found, default=0.0)

    @property
    def ways(self) -> tuple[Way, Way]:
        """In and out."""
        return self.into, self.out

    @property
    def allowed(self) -> float:
        """How long [m] it may be in the part."""
        spare = OF_CONTOUR * self.section.length + OF_BLOCK * self.section.diagonal
        return LONGER * self.section.least(self.lead) + spare


def way_in(context: Context, wire: Wire, segment: Segment, claim: CutsSurface) -> Way | None:
    """The way in to a segment, None where the text has none."""
    rows = np.flatnonzero(wire.labels == segment.at("in").key)
    if not len(rows):
        return None
    return _way(context, wire, np.append(rows[::-1], max(rows[0] - 1, 0)), claim)


def way_out(context: Context, wire: Wire, segment: Segment, claim: CutsSurface) -> Way | None:
    """The way out of a segment, None where the text has none."""
    rows = np.flatnonzero(wire.labels == segment.at("out").key)
    if not len(rows):
        return None
    return _way(context, wire, np.concatenate([[max(rows[0] - 1, 0)], rows]), claim)


def _way(context: Context, wire: Wire, rows: IntArray, claim: CutsSurface) -> Way | None:
    points = wire.points[rows]
    foot, along = points[0, 0], points[0, -1] - points[0, 0]
    along = along / np.linalg.norm(along)
    far = points[-1].mean(axis=0) - points[0].mean(axis=0)
    across = far - (far @ along) * along
    if float(np.linalg.norm(across)) < ROUNDED:
        return None
    away = across / np.linalg.norm(across)
    low, high = int(rows.min()), int(rows.max()) + 1
    time = context.motion.time[wire.sample[low:high]]
    speed = local(wire.points[low:high], time, wire.inside[low:high])[rows - low]
    half = float(0.5 * claim.kerf.at(speed[wire.inside[rows]]).max(initial=0.0))
    return Way(rows, foot, along, away, np.cross(along, away), half)


def slits(context: Context, wire: Wire) -> dict[str, Slit]:
    """The slits that a wire may make in its setup, by the key of the segment that they lead to."""
    out: dict[str, Slit] = {}
    if wire.fault:
        return out
    surfaces = {claim.segment: claim for claim in context.surfaces}
    for claim in context.setup_claims[wire.setup].groups:
        lead = {one.segment: one.way for one in claim if isinstance(one, LeadsFrom)}
        for allowed in (one for one in claim if isinstance(one, SlitsAllowed)):
            for number, contour in enumerate(allowed.contours):
                surface = None if contour.segment is None else surfaces.get(contour.segment)
                if surface is None:
                    continue
                section = Section.of(allowed.contours, number, allowed.box)
                ways = (do(context, wire, surface.segment, surface) for do in (way_in, way_out))
                into, back = ways
                if into is None or back is None or not section.surrounded:
                    continue
                found = _slit(section, wire, surface, (into, back), lead.get(surface.segment))
                out[surface.segment.key] = found
    return out


def _slit(
    section: Section, wire: Wire, claim: CutsSurface, ways: tuple[Way, Way], lead: FloatArray | None
) -> Slit:
    used, ends = 0.0, []
    for way in ways:
        first, last = (section.at(wire.points[way.rows[k], 0], wire.points[way.rows[k], -1]) for k in (0, -1))
        length = float(np.linalg.norm(last - first))
        step = (last - first) / max(length, 1e-12)
        used = max(used, float(section.through(first[None], step[None], np.array([length]))[0]))
        ends.append((first, last))
    apart = float(ways[0].aside(wire.points[ways[1].rows][:, [0, -1]]).max())
    return Slit(claim.segment, *ways, apart, used, section, tuple(ends), claim.tolerance, lead)


def in_slit(slit: Slit, label: str, points: FloatArray, within: FloatArray) -> BoolArray:
    """Which points (N, 3) of a way in or out lie in its slit, within (N,) [m] of its plane, on the outer
    side of its contour."""
    way = slit.into if Segment.read(label).phase == "in" else slit.out
    return np.asarray((way.aside(points) <= within) & ((points - way.foot) @ way.away >= -within))


def off_lead(claim: LeadsFrom, wire: Wire, way: Way) -> tuple[float, int]:
    """How far [m] a way in is off the plane through the first wire beside the surface and the stated
    direction, or behind that wire, at most, beyond half the slot; and the station."""
    wanted = claim.way - (claim.way @ way.along) * way.along
    wanted = wanted / max(float(np.linalg.norm(wanted)), 1e-12)
    ends = wire.points[way.rows][:, [0, -1]] - way.foot
    aside = np.abs(ends @ np.cross(way.along, wanted))
    behind = -dots(ends, np.broadcast_to(wanted, ends.shape))
    off = np.maximum(aside, behind).max(axis=1) - way.half
    k = int(np.argmax(off))
    return float(off[k]), int(way.rows[k])
