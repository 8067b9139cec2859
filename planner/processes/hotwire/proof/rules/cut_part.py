"""Rules on the result of cuts: deviation of surfaces, ridges, and unwanted removal from the part.

The rules are verify.surface, verify.ridge and verify.part. The last one is about foam that slots remove from
the part on leads and next to other surfaces.
"""

import dataclasses
from typing import Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.processes.hotwire.claims import CutsSurface, FollowsRulings, SlitsAllowed
from planner.processes.hotwire.proof.cut_surface import (
    WireSweep,
    make_cut_face,
    max_excess_depth,
    part_obj,
    unreachable_distance,
)
from planner.processes.hotwire.proof.rules.wire import at_wire
from planner.processes.hotwire.proof.slits import find_slits, points_in_slit
from planner.processes.hotwire.proof.walls import (
    PartWalls,
    bent_slot_overlap,
    make_walls,
    straight_slot_overlap,
)
from planner.processes.hotwire.proof.wire_motion import WIRES, WireMotion, block_distance, end_error_deviation
from planner.proof.context import Context
from planner.proof.facts import Fact
from planner.proof.findings import Findings, format_point_mm, measure_in_mm, measure_in_percent
from planner.proof.replay.motion import wire_speed, with_start_stations
from planner.proof.rule import RuleOutcome, mm, rule
from planner.proof.verdict import CutFace


def face_sweeps(context: Context) -> tuple[WireSweep, ...]:
    """Return the sweep of the wire in the segment of each claimed face, without points if it is not cut."""
    followed = [wire for wire in context.get(WIRES) if not wire.fault]
    speeds = [wire_speed(wire.points, context.motion.time[wire.sample], wire.inside) for wire in followed]
    out = []
    for claim in context.claims_of(CutsSurface):
        parts = []
        for wire, speed in zip(followed, speeds, strict=True):
            stations = np.flatnonzero(with_start_stations(wire.labels == claim.segment.key))
            if len(stations) and wire.setup == context.setup_of(claim):
                is_joined = np.append(np.diff(stations) == 1, False)
                parts.append((wire.points[stations], speed[stations], is_joined))
        if parts:
            points, speed, joined = (np.concatenate([part[k] for part in parts]) for k in range(3))
            out.append(WireSweep(points, speed, joined[:-1]))
        else:
            out.append(WireSweep.continuous(np.zeros((0, 2, 3))))
    return tuple(out)


def _cut_faces(context: Context) -> tuple[CutFace, ...]:
    """Compare the faces that wires cut with the nominal ones."""
    claims = context.claims_of(CutsSurface)
    return tuple(
        _with_unreachable_parts(context, claim, make_cut_face(claim, sweep))
        for claim, sweep in zip(claims, context.get(SWEEPS), strict=True)
    )


SWEEPS: Final[Fact[Context, tuple[WireSweep, ...]]] = Fact("sweeps", face_sweeps)
"""The sweep of the wire in the segment of each claimed face."""
CUT_FACES: Final[Fact[Context, tuple[CutFace, ...]]] = Fact("cut faces", _cut_faces)
"""Comparison of cut and nominal faces, without errors of the wire's ends."""


@rule("verify.surface", CutsSurface)
def surface(context: Context) -> RuleOutcome:
    """The required fraction of the cut surface is within tolerance of the nominal one, and in that segment
    the wire nowhere runs much deeper into the part.
    """
    sweeps, faces = context.get(SWEEPS), context.get(CUT_FACES)
    findings = Findings("verify.surface", context)
    _add_gouges(findings, sweeps)
    for face in faces:
        if face.share < face.wanted_share:
            message = (
                f"{100 * face.share:.2f} % of {face.segment} are within {mm(face.tolerance):g} mm of the "
                f"nominal surface; required: {100 * face.wanted_share:g} % "
                f"(rms {mm(face.rms):.3f} mm, largest {mm(face.largest):.3f} mm)"
            )
            findings.add(message, measure_in_percent(face.share, face.wanted_share), field=face.title)
        area = face.area / max(float(face.area.sum()), 1e-30)
        missed = float(area[~np.isfinite(face.deviation)].sum())
        if missed > 1.0 - face.wanted_share:
            message = f"the wire does not pass over {100 * missed:.2f} % of {face.segment}"
            findings.add(message, measure_in_percent(missed, 1 - face.wanted_share), field=face.title)
    if not faces:
        return RuleOutcome(nothing="no face is claimed")
    worst = min(faces, key=lambda face: face.share - face.wanted_share)
    return RuleOutcome(
        tuple(findings.issues),
        100 * worst.share,
        100 * worst.wanted_share,
        "% within tolerance",
        worst.title,
        faces=with_end_error(context, context.get(WIRES), faces),
        part=part_obj(context.claims_of(CutsSurface), sweeps, context.claims_of(FollowsRulings)),
    )


def _with_unreachable_parts(context: Context, claim: CutsSurface, face: CutFace) -> CutFace:
    """Return the face with its share raised by points that deviate because a round wire cannot reach them.

    A point counts as good if no more foam remains than a round wire leaves there, within the tolerance, and
    if that is within what the claim allows. The search for these points is only done if the share without
    them is too small.
    """
    ruled = next(
        (candidate for candidate in context.claims_of(FollowsRulings) if candidate.segment == claim.segment),
        None,
    )
    if ruled is None or face.share >= face.wanted_share:
        return face
    # points that deviate by more than what may remain fail in any case; skip them, as each costs a search
    is_candidate = (face.deviation > face.tolerance) & (face.deviation <= ruled.max_left + face.tolerance)
    candidates = np.flatnonzero(is_candidate)
    if not len(candidates):
        return face
    speed = face.speed[np.isfinite(face.speed)]
    half_slot = 0.5 * float(claim.kerf.at(speed).max())
    unreachable = unreachable_distance(ruled, face.points[candidates], half_slot)
    good = np.abs(face.deviation) <= face.tolerance
    good[candidates] = (face.deviation[candidates] <= unreachable + face.tolerance) & (
        unreachable <= ruled.max_left
    )
    return dataclasses.replace(face, share=float(face.area[good].sum() / max(face.area.sum(), 1e-30)))


def _add_gouges(findings: Findings, sweeps: tuple[WireSweep, ...]) -> None:
    """Report faces below which a bent wire also runs, which the deviation of the cut face does not show.

    That deviation only counts the sheet nearest to each point of the face. Straight wires are left out,
    because the rule on rulings requires more of them.
    """
    context = findings.context
    ruled = {claim.segment.key for claim in context.claims_of(FollowsRulings)}
    for claim, sweep in zip(context.claims_of(CutsSurface), sweeps, strict=True):
        if len(sweep.points) < 2 or claim.segment.key in ruled:
            continue
        block = context.stock_at(context.setup_of(claim))
        depth, _ = max_excess_depth(claim, sweep, block_distance(sweep.points, block) < 0.0)
        limit = MAX_GOUGE_FACTOR * claim.tolerance + FLAT_FACE_ERROR_M
        if depth > limit:
            message = f"the wire runs {mm(depth):.2f} mm below {claim.segment}; allowed: {mm(limit):g} mm"
            findings.add(message, measure_in_mm(depth, limit), field=str(claim.segment))


END_ERROR_STATIONS = 5
"""Number of stations of a wire at which errors of its ends are computed."""
MAX_GOUGE_FACTOR = 3.0
"""Multiple of the tolerance by which a bent wire may run below its face."""
FLAT_FACE_ERROR_M = 3e-4
"""Error [m] of taking a curved face as flat around its samples."""


def with_end_error(
    context: Context, wires: tuple[WireMotion, ...], faces: tuple[CutFace, ...]
) -> tuple[CutFace, ...]:
    """Return the faces with the largest effect of the stated end errors, sampled at a few stations of each.

    Args:
        context: Context of the proof.
        wires: All wires.
        faces: The cut faces.
    """
    out = []
    for face in faces:
        max_deviation = 0.0
        for wire in wires:
            stations = np.flatnonzero((wire.labels == face.segment.key) & wire.inside.any(axis=1))
            if len(stations):
                sampled = stations[
                    np.unique(np.linspace(0, len(stations) - 1, END_ERROR_STATIONS).astype(np.int64))
                ]
                max_deviation = max(max_deviation, float(end_error_deviation(context, wire, sampled).max()))
        good = np.abs(face.deviation) + max_deviation <= face.tolerance
        fraction = float(face.area[good].sum() / max(float(face.area.sum()), 1e-30))
        out.append(dataclasses.replace(face, end_error=max_deviation, share_with_error=fraction))
    return tuple(out)


@rule("verify.ridge")
def ridges(context: Context) -> RuleOutcome:
    """No target of a bent wire deviates by more than the tolerance from the smooth surface through its
    neighbours. Straight wires are compared with their rulings, which may have edges.
    """
    findings = Findings("verify.ridge", context)
    nodes = context.motion.node_sample
    ruled = {claim.segment.key for claim in context.claims_of(FollowsRulings)}
    for claim in context.claims_of(CutsSurface):
        for wire in context.get(WIRES) if claim.segment.key not in ruled else ():
            stations = np.flatnonzero((wire.labels == claim.segment.key) & np.isin(wire.sample, nodes))
            if wire.fault or len(stations) < 5:
                continue
            deviation = _deviation_from_neighbours(wire.points[stations], wire.inside[stations])
            findings.note_highest(deviation.max(), claim.segment, claim.tolerance)
            for i in np.flatnonzero(deviation > claim.tolerance)[:50]:
                message = (
                    f"the wire deviates {mm(deviation[i]):.3f} mm from its neighbours' surface: a ridge or "
                    f"groove; allowed: {mm(claim.tolerance):g} mm"
                )
                at_wire(findings, wire, message, stations[i], measure_in_mm(deviation[i], claim.tolerance))
    return findings.outcome(mm, "mm", nothing="no face is claimed")


def _deviation_from_neighbours(points: FloatArray, inside: BoolArray) -> FloatArray:
    """Return how far (T,) [m] each wire deviates from the cubic through its two neighbours on each side.

    The deviation is measured across the wire and its path.

    Args:
        points: Points at equal arc lengths (T, P, 3) [m].
        inside: Whether each point counts (T, P).
    """
    out = np.zeros(len(points))
    step = np.linalg.norm(np.diff(points, axis=0), axis=2)
    path_length = np.concatenate([np.zeros((1, points.shape[1])), np.cumsum(step, axis=0)])
    positions = np.stack([path_length[k : len(path_length) - 4 + k] for k in range(5)])
    neighbours = (0, 1, 3, 4)
    interpolated = np.zeros_like(points[2:-2])
    # Lagrange interpolation over path length through the wires k - 2, k - 1, k + 1 and k + 2
    for i in neighbours:
        weight = np.ones_like(positions[2])
        for j in neighbours:
            if j != i:
                weight = (
                    weight
                    * (positions[2] - positions[j])
                    / np.where(
                        np.abs(positions[i] - positions[j]) > 1e-9, positions[i] - positions[j], np.inf
                    )
                )
        interpolated += weight[..., None] * points[i : len(points) - 4 + i]
    tangent = np.gradient(points[2:-2], axis=1)
    forward = points[3:-1] - points[1:-3]
    normal = np.cross(tangent, forward)
    normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-15)
    deviation = np.abs(dots(points[2:-2] - interpolated, normal))
    out[2:-2] = np.where(inside[2:-2], deviation, 0.0).max(axis=1)
    return out


MAX_SLOT_WIDTH_M = 0.01
"""Only points closer to a face than this [m] are compared with faces that cross it. Slots are narrower."""
SIDE_TOLERANCE_M = 1e-6
"""A surface with all vertices within this distance [m] of a side of the datum block is that side.

Such a surface bounds raw foam instead of a piece.
"""


@rule("verify.part", CutsSurface, SlitsAllowed, parallel_group="wires")
def part(context: Context) -> RuleOutcome:
    """On lead-ins and lead-outs the wire's slot spares the part, within the tolerance, except for one plane
    slit to what the part lies around. Sides of the datum block are cut from outside. Next to a surface the
    slot spares all other surfaces, whether they are cut before or after.
    """
    wires, findings = context.get(WIRES), Findings("verify.part", context, worst=np.inf)
    face_keys = {claim.segment.key for claim in context.claims_of(CutsSurface)}
    nominal = tuple(claim for claim in context.claims_of(CutsSurface) if not _is_datum_side(context, claim))
    bounds = _PartBounds(context, nominal)
    for wire in wires:
        speed: FloatArray | None = None
        slits_by_segment = find_slits(context, wire)
        for label in (
            sorted(set(wire.labels.tolist()) & wire.cut_segments - face_keys) if not wire.fault else ()
        ):
            stations = np.flatnonzero(wire.labels == label)
            row, column = np.nonzero(wire.inside[stations])
            if not len(row):
                continue
            station = stations[row]
            if speed is None:
                speed = wire_speed(wire.points, context.motion.time[wire.sample], wire.inside)
            points = wire.points[station, column]
            base = Segment.read(label).at("").key
            cut = next((c for c in context.claims_of(CutsSurface) if c.segment.key == base), None)
            half = np.zeros(len(station)) if cut is None else 0.5 * cut.kerf.at(speed[station, column])
            clearance, tolerance = bounds.signed_distance(points)
            if base in slits_by_segment and base != label:
                within = half + np.nan_to_num(tolerance)
                is_in_slit = points_in_slit(slits_by_segment[base], label, points, within)
                clearance = np.where(is_in_slit, np.nan, clearance)
            if cut is not None and cut not in nominal:
                datum = block_distance(points, context.datum)
                clearance, tolerance = np.fmin(clearance, datum), np.fmin(tolerance, cut.tolerance)
            clearance = clearance - half + tolerance
            if not np.isfinite(clearance).any():
                continue
            findings.note_lowest(np.nanmin(clearance), label)
            for i in np.flatnonzero(clearance < 0.0)[:20]:
                depth = float(tolerance[i] - clearance[i])
                message = (
                    f"in {label} the slot is {mm(depth):.2f} mm inside the part; "
                    f"allowed: {mm(tolerance[i]):g} mm"
                )
                at_wire(findings, wire, message, station[i], measure_in_mm(depth, tolerance[i]))
    _add_slot_overlaps(findings, bounds.walls)
    return findings.outcome(mm, "mm left", 0.0, nothing="no lead-in or lead-out in the foam next to the part")


def _add_slot_overlaps(findings: Findings, part: PartWalls) -> None:
    """Report slots next to one surface that remove material from another surface."""
    context = findings.context
    straight = {claim.segment.key for claim in context.claims_of(FollowsRulings)}
    for claim, sweep in zip(context.claims_of(CutsSurface), context.get(SWEEPS), strict=True):
        if len(sweep.points) < 2:
            continue
        find_overlap = straight_slot_overlap if claim.segment.key in straight else bent_slot_overlap
        for other in part.claims:
            overlap = None if other is claim else find_overlap(claim, sweep, other, part)
            if overlap is None:
                continue
            message = (
                f"next to {claim.segment} the slot of {mm(2.0 * overlap.half):.2f} mm removes "
                f"{mm(overlap.depth):.2f} mm of {other.segment} at [{format_point_mm(overlap.point)}] mm; "
                f"allowed: {mm(other.tolerance):g} mm"
            )
            findings.add(message, measure_in_mm(overlap.depth, other.tolerance), field=str(claim.segment))


class _PartBounds:
    """Bounds of the part: closed contours, and faces that may extend beyond them."""

    def __init__(self, context: Context, claims: tuple[CutsSurface, ...]) -> None:
        closed = {
            claim.segment.key
            for claim in context.claims_of(FollowsRulings)
            if np.abs(claim.start[0] - claim.start[-1]).max() < SIDE_TOLERANCE_M
        }
        self.walls = PartWalls(claims, context.datum.box)
        contours = tuple(claim for claim in claims if claim.segment.key in closed)
        self.faces = tuple(claim for claim in claims if claim.segment.key not in closed)
        self.groups = [
            (make_walls(surfaces), np.array([claim.tolerance for claim in surfaces]), surfaces is self.faces)
            for surfaces in (contours, self.faces)
            if surfaces
        ]

    def signed_distance(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return signed distances (N,) [m] of points (N, 3) to the part, and the tolerances (N,) there.

        Distances are negative inside the part and NaN where they are unknown. A point is outside if it is
        outside the contours, outside the nearest face, or outside a face that crosses the nearest one. The
        distance is the largest of these, because the part is at least as far away.
        """
        distance, tolerance = np.full(len(points), -np.inf), np.full(len(points), np.nan)
        for group, limits, are_faces in self.groups:
            group_distance, owner = group.signed_distance(points)
            if are_faces:
                group_distance = self._correct_for_crossings(points, group_distance, owner)
            tolerance = np.where(group_distance > distance, limits[owner], tolerance)
            distance = np.maximum(distance, group_distance)  # NaN remains
        return np.where(np.isinf(distance), np.nan, distance), tolerance

    def _correct_for_crossings(self, points: FloatArray, distance: FloatArray, owner: IntArray) -> FloatArray:
        """Return distances to the nearest face, raised where a point is outside a face that crosses it.

        Args:
            points: Points (N, 3) [m].
            distance: Signed distances to the nearest face (N,) [m].
            owner: Index of that face in ``faces`` (N,).
        """
        distance = distance.copy()
        for number in np.unique(owner[distance < MAX_SLOT_WIDTH_M]).tolist():
            for other in self.walls.crossing_surfaces(self.faces[number]):
                if any(other is face for face in self.faces):
                    affected = np.flatnonzero((distance < MAX_SLOT_WIDTH_M) & (owner == number))
                    crossing_distance, _ = self.walls.wall(other).signed_distance(points[affected])
                    distance[affected] = np.where(
                        crossing_distance > np.maximum(distance[affected], 0.0),
                        crossing_distance,
                        distance[affected],
                    )
        return distance


def _is_datum_side(context: Context, claim: CutsSurface) -> bool:
    """Return whether all vertices of a claim's surface are on one side of the datum block."""
    box = context.datum.box
    return bool((np.abs(claim.vertices[:, None] - box[None]).max(axis=0) < SIDE_TOLERANCE_M).any())
