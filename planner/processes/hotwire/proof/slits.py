"""Slits that lead-ins and lead-outs of straight wires cut through the part, as the programs state them.

The module finds the slit that the wire cuts on its way to a contour, and compares its length in the part with
that of the shortest slit. The part is projected along the rulings of one of its contours, on the plane normal
to the contour's mean ruling. Every contour is the polygon of its rulings' middles there. The smallest contour
around a point decides whether it is solid: the part is inside outlines and outside holes. If no contour is
around it, the block is solid if the part has only holes.
"""

import dataclasses
from typing import Final, Literal

import numpy as np
from scipy.spatial import ConvexHull

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.processes.hotwire.claims import Contour, CutsSurface, LeadsFrom, SlitsAllowed
from planner.processes.hotwire.proof.wire_motion import WireMotion
from planner.proof.context import Context
from planner.proof.replay.motion import wire_speed

SLIT_START_SAMPLES: Final = 36
"""Number of points of a contour at which slits are tried."""
SLIT_DIRECTION_SAMPLES: Final = 36
"""Number of directions that are tried at each point."""
MAX_LENGTH_PER_CROSSING: Final = 8.0
"""Allowed length of a slit close to another contour at each crossing, in half slots.

A slit is within half a slot of a straight contour for 2 / sin(angle) half slots: 8 at about 15 degrees.
"""
OWN_CONTOUR_TOLERANCE_M: Final = 1e-6
"""Edges that a slit crosses within this distance [m] of its start belong to the contour that it leads to."""
_PAIR_BATCH_SIZE: Final = 2_000_000
"""Number of pairs of a point and an edge that are processed in one batch."""


@dataclasses.dataclass(frozen=True)
class ContourSection:
    """Contour ``index`` and all others in a plane across its rulings, as polygons with E edges in total.

    Attributes:
        index: Number of the contour.
        axis: Mean ruling (3,).
        axes: Axes of the plane (3, 2).
        level: Position of the polygons along ``axis`` [m].
        edge_start: Start of each edge (E, 2) [m].
        edge_end: End of each edge (E, 2) [m].
        owner: Index of the contour of each edge (E,).
        holes: Whether each contour is a hole (C,).
        areas: Area of each contour (C,) [m^2].
        corner: Whether each vertex of contour ``index`` is a corner (M,).
        block: Sides of the block's outline (K, 3): unit normal n and offset d, with n.x + d < 0 inside.
        diagonal: Diagonal of the block [m].
    """

    index: int
    axis: FloatArray
    axes: FloatArray
    level: float
    edge_start: FloatArray
    edge_end: FloatArray
    owner: IntArray
    holes: BoolArray
    areas: FloatArray
    corner: BoolArray
    block: FloatArray
    diagonal: float

    @staticmethod
    def across(contours: tuple[Contour, ...], index: int, box: FloatArray) -> "ContourSection":
        """Return the section across one contour of a part.

        Args:
            contours: All contours of the part.
            index: Number of the contour.
            box: Lower and upper corner of the block (2, 3) [m].
        """
        middles = [0.5 * (contour.start + contour.end) for contour in contours]
        axis = (contours[index].end - contours[index].start).mean(axis=0)
        axis = axis / max(float(np.linalg.norm(axis)), 1e-12)
        axes = np.linalg.svd(axis[None])[2][1:].T
        flat = [middle @ axes for middle in middles]
        corners = np.array([[x, y, z] for x in box[:, 0] for y in box[:, 1] for z in box[:, 2]])
        return ContourSection(
            index=index,
            axis=axis,
            axes=axes,
            level=float(middles[index].mean(axis=0) @ axis),
            edge_start=np.concatenate(flat),
            edge_end=np.concatenate([np.roll(polygon, -1, axis=0) for polygon in flat]),
            owner=np.repeat(np.arange(len(flat)), [len(polygon) for polygon in flat]),
            holes=np.array([contour.hole for contour in contours]),
            areas=np.array([abs(_signed_area(polygon)) for polygon in flat]),
            corner=contours[index].corner,
            block=ConvexHull(corners @ axes).equations,
            diagonal=float(np.linalg.norm(box[1] - box[0])),
        )

    @property
    def polygon(self) -> FloatArray:
        """Contour ``index`` (M, 2) [m]."""
        return np.asarray(self.edge_start[self.owner == self.index])

    @property
    def is_surrounded(self) -> bool:
        """Whether the part lies around contour ``index``, so that a slit to it must cut the part.

        It does if the contour is a hole, or lies in a larger hole.
        """
        if self.holes[self.index]:
            return True
        ring = self.polygon
        return any(
            _encloses(ring, self.edge_start[self.owner == k]).mean() > 0.5
            and self.areas[k] > self.areas[self.index]
            for k in np.flatnonzero(self.holes)
        )

    @property
    def length(self) -> float:
        """Length of the contour [m]."""
        contour_edges = self.owner == self.index
        return float(
            np.linalg.norm(self.edge_end[contour_edges] - self.edge_start[contour_edges], axis=1).sum()
        )

    def intersect(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Return the intersection (..., 2) of lines from ``start`` to ``end`` (..., 3) with the plane."""
        vector = end - start
        fraction = (self.level - start @ self.axis) / (vector @ self.axis)
        return np.asarray((start + fraction[..., None] * vector) @ self.axes)

    def length_in_part(self, base: FloatArray, direction: FloatArray, length: FloatArray) -> FloatArray:
        """Return the length (R,) [m] of slits that is in the part.

        Args:
            base: Starts of the slits (R, 2) [m].
            direction: Unit vectors of the slits (R, 2).
            length: Maximum length of the slits (R,) [m].
        """
        length = np.minimum(length, self._distance_to_border(base, direction))
        out = np.zeros(len(base))
        step = max(1, _PAIR_BATCH_SIZE // max(len(self.edge_start), 1))
        for low in range(0, len(base), step):
            batch = slice(low, low + step)
            out[batch] = self._batch_length_in_part(base[batch], direction[batch], length[batch])
        return out

    def _batch_length_in_part(
        self, base: FloatArray, direction: FloatArray, length: FloatArray
    ) -> FloatArray:
        """Return `length_in_part` of one batch: sort each slit's crossings and add up its solid pieces.

        A piece lies between two crossings, or before the first or after the last one.
        """
        edge = self.edge_end - self.edge_start
        to_edge = self.edge_start[None] - base[:, None]
        cross = direction[:, None, 0] * edge[None, :, 1] - direction[:, None, 1] * edge[None, :, 0]
        cross = np.where(np.abs(cross) > 1e-15, cross, np.inf)
        distances = (to_edge[..., 0] * edge[:, 1] - to_edge[..., 1] * edge[:, 0]) / cross
        edge_fraction = (
            to_edge[..., 0] * direction[:, None, 1] - to_edge[..., 1] * direction[:, None, 0]
        ) / cross
        row, column = np.nonzero(
            (edge_fraction >= 0.0) & (edge_fraction < 1.0) & (distances > OWN_CONTOUR_TOLERANCE_M)
        )
        order = np.lexsort((distances[row, column], row))
        row, column = row[order], column[order]
        count = np.bincount(row, minlength=len(base))
        crossing_index = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
        max_crossings = int(count.max(initial=0))
        crossing_distance = np.full((len(base), max_crossings), np.inf)
        crossing_owner = np.full((len(base), max_crossings), -1)
        crossing_distance[row, crossing_index] = distances[row, column]
        crossing_owner[row, crossing_index] = self.owner[column]
        # far outside no contour is around the point; each border passed on the way back enters or leaves one
        # (slit, crossing from the farthest on, contour from the smallest on)
        toggles = crossing_owner[:, ::-1, None] == np.argsort(self.areas)[None, None]
        is_around = np.concatenate(
            [np.zeros((len(base), 1, len(self.areas)), dtype=np.int64), np.cumsum(toggles, axis=1)], axis=1
        )[:, ::-1]
        is_around = is_around % 2 == 1
        smallest = np.argmax(is_around, axis=2)  # the first one around the piece, in ascending order of areas
        solid = np.where(
            is_around.any(axis=2), ~self.holes[np.argsort(self.areas)][smallest], self.holes.all()
        )
        ends = np.concatenate(
            [np.zeros((len(base), 1)), crossing_distance, np.full((len(base), 1), np.inf)], axis=1
        )
        pieces = np.diff(np.minimum(ends, length[:, None]), axis=1)
        return np.asarray(np.where(solid, pieces, 0.0).sum(axis=1))

    def excess_length_alongside(
        self, start: FloatArray, end: FloatArray, half: float, max_distance: float
    ) -> float:
        """Return the length [m] that a slit runs near another contour, minus what its crossings need.

        It is the largest value over all other contours, at least 0.

        Args:
            start: Start of the slit (2,) [m].
            end: End of the slit (2,) [m].
            half: Half the width of the slit [m].
            max_distance: Distance from the contour that counts as near [m].
        """
        length = float(np.linalg.norm(end - start))
        count = max(int(np.ceil(length / (0.25 * max_distance))), 2)
        points = start + ((np.arange(count) + 0.5) / count)[:, None] * (end - start)
        max_excess = 0.0
        for other in np.flatnonzero(np.arange(len(self.areas)) != self.index):
            a, b = self.edge_start[self.owner == other], self.edge_end[self.owner == other]
            edge, gap = b - a, points[:, None] - a
            fraction = (gap * edge).sum(axis=2) / np.maximum((edge * edge).sum(axis=1), 1e-30)
            distance = np.linalg.norm(gap - np.clip(fraction, 0.0, 1.0)[..., None] * edge, axis=2).min(axis=1)
            # an edge is crossed if its ends are on different sides of the slit and vice versa
            is_left = [_cross_2d(end - start, corner - start) > 0.0 for corner in (a, b)]
            is_over = [_cross_2d(edge, point - a) > 0.0 for point in (start, end)]
            crossings = int(((is_left[0] != is_left[1]) & (is_over[0] != is_over[1])).sum())
            max_excess = max(
                max_excess,
                float((distance < max_distance).mean()) * length - MAX_LENGTH_PER_CROSSING * half * crossings,
            )
        return max_excess

    def min_length_in_part(self, lead: FloatArray | None) -> float:
        """Return the smallest length [m] in the part that a slit to the contour needs.

        Slits are tried at points of the contour and in several directions. A slit to an outline starts at one
        of its outer corners, if it has any.

        Args:
            lead: The only direction to try (3,), or None for all.
        """
        starts = self._slit_starts()
        if lead is None:
            angle = 2.0 * np.pi * np.arange(SLIT_DIRECTION_SAMPLES) / SLIT_DIRECTION_SAMPLES
            directions = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        else:
            directions = (lead @ self.axes)[None]
            directions = directions / max(float(np.linalg.norm(directions)), 1e-12)
        base, direction = np.repeat(starts, len(directions), axis=0), np.tile(directions, (len(starts), 1))
        return float(self.length_in_part(base, direction, np.full(len(base), np.inf)).min())

    def _slit_starts(self) -> FloatArray:
        """Return the points (K, 2) [m] of the contour at which slits are tried.

        These are the outer corners of an outline if it has any, else `SLIT_START_SAMPLES` even positions.
        """
        ring = self.polygon
        if not self.holes[self.index]:
            incoming, outgoing = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
            rotation = np.arctan2(_cross_2d(incoming, outgoing), np.sum(incoming * outgoing, axis=1))
            is_outer_corner = self.corner & (rotation * np.sign(_signed_area(ring)) > 0.0)
            if is_outer_corner.any():
                return np.asarray(ring[is_outer_corner])
        closed = np.concatenate([ring, ring[:1]])
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
        marks = np.linspace(0.0, along[-1], SLIT_START_SAMPLES, endpoint=False)
        return np.stack([np.interp(marks, along, closed[:, i]) for i in range(2)], axis=1)

    def _distance_to_border(self, base: FloatArray, direction: FloatArray) -> FloatArray:
        """Return the distance (R,) [m] from ``base`` along a direction (R, 2) to the border of the block."""
        normal, offset = self.block[:, :2], self.block[:, 2]
        approach = direction @ normal.T
        distance = -(base @ normal.T + offset) / np.where(approach > 1e-12, approach, 1.0)
        return np.asarray(np.maximum(np.where(approach > 1e-12, distance, np.inf).min(axis=1), 0.0))


def _cross_2d(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _signed_area(polygon: FloatArray) -> float:
    return float(0.5 * _cross_2d(polygon, np.roll(polygon, -1, axis=0)).sum())


def _encloses(points: FloatArray, polygon: FloatArray) -> BoolArray:
    """Return whether a polygon (M, 2) encloses each point (N, 2), by the angle that it covers from there."""
    spoke = polygon[None] - points[:, None]
    following = np.roll(spoke, -1, axis=1)
    rotation = np.arctan2(_cross_2d(spoke, following), np.sum(spoke * following, axis=2)).sum(axis=1)
    return np.asarray(np.abs(rotation) > np.pi)


SLIT_LENGTH_FACTOR: Final = 1.25
"""Factor by which a slit may be longer in the part than the shortest one that is found."""
SLIT_CONTOUR_FRACTION: Final = 0.02
"""Additional length of a slit, as a fraction of its contour. The planner starts at one of a few points."""
SLIT_DIAGONAL_FRACTION: Final = 0.0025
"""Additional length of a slit, as a fraction of the block's diagonal.

It allows cuts with a better last side or better turns.
"""
SLIT_ROUNDING_M: Final = 1e-4
"""Amount [m] that rounded targets may add to the width and length of a slit."""


@dataclasses.dataclass(frozen=True)
class LeadPath:
    """A lead-in or lead-out.

    Attributes:
        rows: Indices of its N stations (N,), from the wire next to the contour outwards.
        wire_point: A point of that wire (3,) [m].
        wire_direction: Direction of that wire (3,).
        lead_direction: Unit vector across that wire to where the wire comes from (3,).
        normal: Normal of the plane of both (3,).
        half: Half the widest slot in the foam [m].
    """

    rows: IntArray
    wire_point: FloatArray
    wire_direction: FloatArray
    lead_direction: FloatArray
    normal: FloatArray
    half: float

    def plane_distance(self, points: FloatArray) -> FloatArray:
        """Return the distance (...,) [m] of points (..., 3) from the plane."""
        return np.asarray(np.abs((points - self.wire_point) @ self.normal))


@dataclasses.dataclass(frozen=True)
class Slit:
    """The slit to a contour that is cut.

    Attributes:
        segment: Segment that cuts the contour.
        into: Lead-in.
        out: Lead-out.
        lead_out_deviation: Largest distance of the lead-out from the plane of the lead-in [m].
        length_in_part: Length of the slit in the part [m].
        section: Section across the contour.
        ends: Start at the contour and end (2,) [m] in the section, for both leads.
        tolerance: Tolerance of the cut [m].
        lead: Required direction (3,), or None.
    """

    segment: Segment
    into: LeadPath
    out: LeadPath
    lead_out_deviation: float
    length_in_part: float
    section: ContourSection
    ends: tuple[tuple[FloatArray, FloatArray], ...]
    tolerance: float
    lead: FloatArray | None

    @property
    def excess_length_alongside(self) -> float:
        """Length [m] that the slit runs along another contour, minus what its crossings need.

        The slit runs along a contour where it removes more of it than the tolerance.
        """
        lengths = [
            self.section.excess_length_alongside(*ends, lead.half, lead.half - self.tolerance)
            for ends, lead in zip(self.ends, self.leads, strict=True)
            if lead.half > self.tolerance
        ]
        return max(lengths, default=0.0)

    @property
    def leads(self) -> tuple[LeadPath, LeadPath]:
        """Lead-in and lead-out."""
        return self.into, self.out

    @property
    def max_length(self) -> float:
        """Allowed length [m] in the part."""
        allowance = (
            SLIT_CONTOUR_FRACTION * self.section.length + SLIT_DIAGONAL_FRACTION * self.section.diagonal
        )
        return SLIT_LENGTH_FACTOR * self.section.min_length_in_part(self.lead) + allowance


def lead_path(
    context: Context, wire: WireMotion, claim: CutsSurface, phase: Literal["in", "out"]
) -> LeadPath | None:
    """Return the lead-in to the segment of a cut, or the lead-out, or None if the programs have none.

    Args:
        context: Context of the proof.
        wire: The wire.
        claim: Claim on the cut.
        phase: ``in`` for the lead-in, ``out`` for the lead-out.
    """
    rows = np.flatnonzero(wire.labels == claim.segment.at(phase).key)
    if not len(rows):
        return None
    previous = max(rows[0] - 1, 0)
    rows = np.append(rows[::-1], previous) if phase == "in" else np.append(previous, rows)
    return _make_lead_path(context, wire, rows, claim)


def _make_lead_path(
    context: Context, wire: WireMotion, rows: IntArray, claim: CutsSurface
) -> LeadPath | None:
    """Return the lead at stations ``rows`` (N,), or None if the wire hardly moves across itself on it.

    The lead must be at least `SLIT_ROUNDING_M` long across the wire. The stations begin with the wire next to
    the contour.
    """
    points = wire.points[rows]
    foot, along = points[0, 0], points[0, -1] - points[0, 0]
    along = along / np.linalg.norm(along)
    vector = points[-1].mean(axis=0) - points[0].mean(axis=0)
    across = vector - (vector @ along) * along
    if float(np.linalg.norm(across)) < SLIT_ROUNDING_M:
        return None
    away = across / np.linalg.norm(across)
    low, high = int(rows.min()), int(rows.max()) + 1
    time = context.motion.time[wire.sample[low:high]]
    speed = wire_speed(wire.points[low:high], time, wire.inside[low:high])[rows - low]
    half = float(0.5 * claim.kerf.at(speed[wire.inside[rows]]).max(initial=0.0))
    return LeadPath(rows, foot, along, away, np.cross(along, away), half)


def find_slits(context: Context, wire: WireMotion) -> dict[str, Slit]:
    """Return the slits that a wire makes in its setup, by the key of the segment that they lead to.

    Only contours count that the part surrounds and that have both a lead-in and a lead-out.
    """
    out: dict[str, Slit] = {}
    if wire.fault:
        return out
    surfaces = {claim.segment: claim for claim in context.claims_of(CutsSurface)}
    for group in context.setup_claims[wire.setup].groups:
        directions = {claim.segment: claim.direction for claim in group if isinstance(claim, LeadsFrom)}
        for allowed in (claim for claim in group if isinstance(claim, SlitsAllowed)):
            for number, contour in enumerate(allowed.contours):
                surface = None if contour.segment is None else surfaces.get(contour.segment)
                if surface is None:
                    continue
                section = ContourSection.across(allowed.contours, number, allowed.box)
                into = lead_path(context, wire, surface, "in")
                lead_out = lead_path(context, wire, surface, "out")
                if into is None or lead_out is None or not section.is_surrounded:
                    continue
                slit = _make_slit(section, wire, surface, (into, lead_out), directions.get(surface.segment))
                out[surface.segment.key] = slit
    return out


def _make_slit(
    section: ContourSection,
    wire: WireMotion,
    claim: CutsSurface,
    leads: tuple[LeadPath, LeadPath],
    lead: FloatArray | None,
) -> Slit:
    """Return the slit of a lead-in and a lead-out. Its length in the part is that of the longer one."""
    length_in_part = 0.0
    ends = []
    for path in leads:
        first, last = (
            section.intersect(wire.points[path.rows[k], 0], wire.points[path.rows[k], -1]) for k in (0, -1)
        )
        length = float(np.linalg.norm(last - first))
        step = (last - first) / max(length, 1e-12)
        length_in_part = max(
            length_in_part, float(section.length_in_part(first[None], step[None], np.array([length]))[0])
        )
        ends.append((first, last))
    lead_out_deviation = float(leads[0].plane_distance(wire.points[leads[1].rows][:, [0, -1]]).max())
    return Slit(
        claim.segment, *leads, lead_out_deviation, length_in_part, section, tuple(ends), claim.tolerance, lead
    )


def points_in_slit(slit: Slit, label: str, points: FloatArray, within: FloatArray) -> BoolArray:
    """Return whether each point (N, 3) of a lead lies in its slit, on the outer side of its contour.

    Args:
        slit: The slit.
        label: Segment of the lead.
        points: Points (N, 3) [m].
        within: Allowed distance from the slit's plane (N,) [m].
    """
    lead = slit.into if Segment.read(label).phase == "in" else slit.out
    return np.asarray(
        (lead.plane_distance(points) <= within)
        & ((points - lead.wire_point) @ lead.lead_direction >= -within)
    )


def lead_deviation(claim: LeadsFrom, wire: WireMotion, lead_in: LeadPath) -> tuple[float, int]:
    """Return the largest deviation [m] of a lead-in from the stated direction, and the index of the station.

    The deviation is the distance from the plane through the first wire next to the surface and the stated
    direction, or the distance beyond that wire against the direction. Half the slot is subtracted.

    Args:
        claim: Claim on the direction.
        wire: The wire.
        lead_in: The lead-in.
    """
    required = claim.direction - (claim.direction @ lead_in.wire_direction) * lead_in.wire_direction
    required = required / max(float(np.linalg.norm(required)), 1e-12)
    ends = wire.points[lead_in.rows][:, [0, -1]] - lead_in.wire_point
    distance_aside = np.abs(ends @ np.cross(lead_in.wire_direction, required))
    distance_behind = -dots(ends, np.broadcast_to(required, ends.shape))
    deviation = np.maximum(distance_aside, distance_behind).max(axis=1) - lead_in.half
    k = int(np.argmax(deviation))
    return float(deviation[k]), int(lead_in.rows[k])
