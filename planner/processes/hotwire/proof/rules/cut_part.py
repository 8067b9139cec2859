"""Rules on what cuts leave: the surface, its ridges, the part beside it, and the order of the cuts.

verify.surface, ridge. verify.part, order: what slots take from the part on the ways in and out and
from other surfaces, and what has to be cut before what.
"""

import dataclasses
from typing import Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.processes.hotwire.claims import CutsSurface, FollowsRulings, SlitsAllowed
from planner.processes.hotwire.proof.cut_surface import Sweep, cut_face, deepest, part_obj, unreached
from planner.processes.hotwire.proof.rules.wire import at_wire
from planner.processes.hotwire.proof.slits import in_slit, slits
from planner.processes.hotwire.proof.walls import PartWalls, taken_by_bent, taken_depth, walls
from planner.processes.hotwire.proof.wire_motion import WIRES, Wire, end_error, to_block
from planner.proof.context import Context
from planner.proof.facts import Fact
from planner.proof.findings import Findings, coordinates, in_mm, in_percent
from planner.proof.replay.motion import during, local
from planner.proof.rule import Outcome, mm, rule
from planner.proof.verdict import CutFace


def sweeps(context: Context) -> tuple[Sweep, ...]:
    """The wire's shapes in the segment of each wanted face."""
    good = [wire for wire in context.get(WIRES) if not wire.fault]
    speeds = [local(wire.points, context.motion.time[wire.sample], wire.inside) for wire in good]
    out = []
    for claim in context.of(CutsSurface):
        parts = []
        for wire, speed in zip(good, speeds, strict=True):
            rows = np.flatnonzero(during(wire.labels == claim.segment.key))
            if len(rows) and wire.setup == context.setup_of(claim):
                parts.append((wire.points[rows], speed[rows], np.append(np.diff(rows) == 1, False)))
        if parts:
            points, speed, joined = (np.concatenate([part[k] for part in parts]) for k in range(3))
            out.append(Sweep(points, speed, joined[:-1]))
        else:
            out.append(Sweep.steady(np.zeros((0, 2, 3))))
    return tuple(out)


def _cut_faces(context: Context) -> tuple[CutFace, ...]:
    """The faces that wires cut, against the wanted ones."""
    claims = context.of(CutsSurface)
    return tuple(
        _reachable(context, claim, cut_face(claim, row))
        for claim, row in zip(claims, context.get(SWEEPS), strict=True)
    )


SWEEPS: Final[Fact[Context, tuple[Sweep, ...]]] = Fact("sweeps", sweeps)
"""The wire's shapes in the segment of each wanted face."""
CUT_FACES: Final[Fact[Context, tuple[CutFace, ...]]] = Fact("cut faces", _cut_faces)
"""The faces that wires cut, without the error of the wire's ends."""


@rule("verify.surface", CutsSurface)
def surface(context: Context) -> Outcome:
    """The cut surface is within tolerance of the wanted one for the wanted share of it, and in that segment
    the wire nowhere runs much deeper into the part."""
    rows, faces = context.get(SWEEPS), context.get(CUT_FACES)
    findings = Findings("verify.surface", context)
    _gouges(findings, rows)
    for face in faces:
        if face.share < face.wanted_share:
            message = (
                f"{100 * face.share:.2f} % of {face.segment} are within {mm(face.tolerance):g} mm of the "
                f"wanted surface; wanted: {100 * face.wanted_share:g} % "
                f"(rms {mm(face.rms):.3f} mm, largest {mm(face.largest):.3f} mm)"
            )
            findings.add(message, in_percent(face.share, face.wanted_share), field=face.title)
        area = face.area / max(float(face.area.sum()), 1e-30)
        missed = float(area[~np.isfinite(face.deviation)].sum())
        if missed > 1.0 - face.wanted_share:
            message = f"the wire does not pass over {100 * missed:.2f} % of {face.segment}"
            findings.add(message, in_percent(missed, 1 - face.wanted_share), field=face.title)
    if not faces:
        return Outcome(nothing="no face is claimed")
    worst = min(faces, key=lambda face: face.share - face.wanted_share)
    return Outcome(
        tuple(findings.issues),
        100 * worst.share,
        100 * worst.wanted_share,
        "% within tolerance",
        worst.title,
        faces=with_end_error(context, context.get(WIRES), faces),
        part=part_obj(context.of(CutsSurface), rows, context.of(FollowsRulings)),
    )


def _reachable(context: Context, claim: CutsSurface, face: CutFace) -> CutFace:
    """The face with what a round wire cannot reach of it as good as it can be, where so much of it is off
    that this counts."""
    ruled = next((one for one in context.of(FollowsRulings) if one.segment == claim.segment), None)
    if ruled is None or face.share >= face.wanted_share:
        return face
    # what stands farther than may be left by far is off whatever a wire reaches, and costs a search a point
    off = (face.deviation > face.tolerance) & (face.deviation <= ruled.left + face.tolerance)
    high = np.flatnonzero(off)
    if not len(high):
        return face
    speed = face.speed[np.isfinite(face.speed)]
    more = unreached(ruled, face.points[high], 0.5 * float(claim.kerf.at(speed).max()))
    good = np.abs(face.deviation) <= face.tolerance
    good[high] = (face.deviation[high] <= more + face.tolerance) & (more <= ruled.left)
    return dataclasses.replace(face, share=float(face.area[good].sum() / max(face.area.sum(), 1e-30)))


def _gouges(findings: Findings, rows: tuple[Sweep, ...]) -> None:
    """Faces into which the wire cuts besides: the nearest sheet of several hides those beneath it. Straight
    wires keep to their rulings all along, which is more."""
    context = findings.context
    ruled = {claim.segment.key for claim in context.of(FollowsRulings)}
    for claim, sweep in zip(context.of(CutsSurface), rows, strict=True):
        if len(sweep.points) < 2 or claim.segment.key in ruled:
            continue
        block = context.stock(context.setup_of(claim))
        deep, _ = deepest(claim, sweep, to_block(sweep.points, block) < 0.0)
        limit = GOUGE_TOLERANCES * claim.tolerance + BENT_FACE_ERROR
        if deep > limit:
            what = f"the wire runs {mm(deep):.2f} mm deep below {claim.segment}; allowed: {mm(limit):g} mm"
            findings.add(what, in_mm(deep, limit), field=str(claim.segment))


ERROR_STATIONS = 5
"""Stations of a wire at which errors of its ends are worked out."""
GOUGE_TOLERANCES = 3.0
"""A wire may run deeper than wanted by so many tolerances, in places."""
BENT_FACE_ERROR = 3e-4
"""What taking a bent face as flat around its samples may cost [m]."""


def with_end_error(
    context: Context, wires: tuple[Wire, ...], faces: tuple[CutFace, ...]
) -> tuple[CutFace, ...]:
    """The faces with what the stated error of the wire's ends may add, looked at in a few places of each."""
    out = []
    for face in faces:
        worst = 0.0
        for wire in wires:
            rows = np.flatnonzero((wire.labels == face.segment.key) & wire.inside.any(axis=1))
            if len(rows):
                some = rows[np.unique(np.linspace(0, len(rows) - 1, ERROR_STATIONS).astype(np.int64))]
                worst = max(worst, float(end_error(context, wire, some).max()))
        good = np.abs(face.deviation) + worst <= face.tolerance
        share = float(face.area[good].sum() / max(float(face.area.sum()), 1e-30))
        out.append(dataclasses.replace(face, end_error=worst, share_with_error=share))
    return tuple(out)


@rule("verify.ridge")
def ridges(context: Context) -> Outcome:
    """No target of a bent wire stands out of the smooth surface that its neighbours make by more than the
    tolerance; a straight one is held against its rulings, which may have edges."""
    findings = Findings("verify.ridge", context)
    nodes = context.motion.node_sample
    ruled = {claim.segment.key for claim in context.of(FollowsRulings)}
    for claim in context.of(CutsSurface):
        for wire in context.get(WIRES) if claim.segment.key not in ruled else ():
            rows = np.flatnonzero((wire.labels == claim.segment.key) & np.isin(wire.sample, nodes))
            if wire.fault or len(rows) < 5:
                continue
            out = _standing_out(wire.points[rows], wire.inside[rows])
            findings.highest(out.max(), claim.segment, claim.tolerance)
            for i in np.flatnonzero(out > claim.tolerance)[:50]:
                message = (
                    f"the wire is {mm(out[i]):.3f} mm off the surface of its neighbours: a ridge or groove; "
                    f"allowed: {mm(claim.tolerance):g} mm"
                )
                at_wire(findings, wire, message, rows[i], in_mm(out[i], claim.tolerance))
    return findings.outcome(mm, "mm", nothing="no face is claimed")


def _standing_out(points: FloatArray, inside: BoolArray) -> FloatArray:
    """How far (T,) [m] each wire is off the cubic through the two wires before and the two behind it.

    ``points`` (T, P, 3) at equal arc lengths; measured across the wire and its way, at points ``inside`` (T,
    P).
    """
    out = np.zeros(len(points))
    step = np.linalg.norm(np.diff(points, axis=0), axis=2)
    way = np.concatenate([np.zeros((1, points.shape[1])), np.cumsum(step, axis=0)])
    at = np.stack([way[k : len(way) - 4 + k] for k in range(5)])
    near = (0, 1, 3, 4)
    guess = np.zeros_like(points[2:-2])
    for i in near:
        weight = np.ones_like(at[2])
        for j in near:
            if j != i:
                weight = (
                    weight * (at[2] - at[j]) / np.where(np.abs(at[i] - at[j]) > 1e-9, at[i] - at[j], np.inf)
                )
        guess += weight[..., None] * points[i : len(points) - 4 + i]
    tangent = np.gradient(points[2:-2], axis=1)
    forward = points[3:-1] - points[1:-3]
    normal = np.cross(tangent, forward)
    normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-15)
    off = np.abs(dots(points[2:-2] - guess, normal))
    out[2:-2] = np.where(inside[2:-2], off, 0.0).max(axis=1)
    return out


BESIDE = 0.01
"""Points nearer to a face than this [m] are held against the faces that it crosses: no slot is as wide."""
SIDE_DISTANCE = 1e-6
"""A surface all of whose vertices are so near to one side of the datum block [m] is that side, and bounds raw
foam instead of a piece."""


@rule("verify.part", CutsSurface, SlitsAllowed, ahead="wires")
def part(context: Context) -> Outcome:
    """On its ways in and out the wire's slot keeps off the part, within the tolerance, but for one plane
    slit to what the part lies around; sides of the datum block are cut from outside. Beside a surface the
    slot keeps off all the others, those that are cut already and those to come."""
    wires, findings = context.get(WIRES), Findings("verify.part", context, worst=np.inf)
    own = {claim.segment.key for claim in context.of(CutsSurface)}
    wanted = tuple(claim for claim in context.of(CutsSurface) if not _is_side(context, claim))
    bounds = _Bounds(context, wanted)
    for wire in wires:
        speed: FloatArray | None = None
        through = slits(context, wire)
        for label in sorted(set(wire.labels.tolist()) & wire.cuts - own) if not wire.fault else ():
            rows = np.flatnonzero(wire.labels == label)
            row, column = np.nonzero(wire.inside[rows])
            if not len(row):
                continue
            row = rows[row]
            if speed is None:
                speed = local(wire.points, context.motion.time[wire.sample], wire.inside)
            points = wire.points[row, column]
            base = Segment.read(label).at("").key
            cut = next((c for c in context.of(CutsSurface) if c.segment.key == base), None)
            half = np.zeros(len(row)) if cut is None else 0.5 * cut.kerf.at(speed[row, column])
            room, tolerance = bounds.off(points)
            if base in through and base != label:
                slit = in_slit(through[base], label, points, half + np.nan_to_num(tolerance))
                room = np.where(slit, np.nan, room)
            if cut is not None and cut not in wanted:
                datum = to_block(points, context.datum)
                room, tolerance = np.fmin(room, datum), np.fmin(tolerance, cut.tolerance)
            room = room - half + tolerance
            if not np.isfinite(room).any():
                continue
            findings.lowest(np.nanmin(room), label)
            for i in np.flatnonzero(room < 0.0)[:20]:
                deep = float(tolerance[i] - room[i])
                what = (
                    f"in {label} the slot is {mm(deep):.2f} mm inside the part; "
                    f"allowed: {mm(tolerance[i]):g} mm"
                )
                at_wire(findings, wire, what, row[i], in_mm(deep, tolerance[i]))
    _beside(findings, bounds.walls)
    return findings.outcome(mm, "mm left", 0.0, nothing="no way in or out in the foam beside the part")


def _beside(findings: Findings, part: PartWalls) -> None:
    """What slots take from other surfaces than those beside which they cut."""
    context = findings.context
    straight = {claim.segment.key for claim in context.of(FollowsRulings)}
    for claim, sweep in zip(context.of(CutsSurface), context.get(SWEEPS), strict=True):
        if len(sweep.points) < 2:
            continue
        take = taken_depth if claim.segment.key in straight else taken_by_bent
        for other in part.claims:
            found = None if other is claim else take(claim, sweep, other, part)
            if found is None:
                continue
            what = (
                f"beside {claim.segment} the slot of {mm(2.0 * found.half):.2f} mm takes "
                f"{mm(found.depth):.2f} mm off {other.segment} at [{coordinates(found.place)}] mm; "
                f"allowed: {mm(other.tolerance):g} mm"
            )
            findings.add(what, in_mm(found.depth, other.tolerance), field=str(claim.segment))


class _Bounds:
    """What bounds the part: contours that are closed, and faces that may go on beyond these."""

    def __init__(self, context: Context, claims: tuple[CutsSurface, ...]) -> None:
        closed = {
            claim.segment.key
            for claim in context.of(FollowsRulings)
            if np.abs(claim.start[0] - claim.start[-1]).max() < SIDE_DISTANCE
        }
        self.walls = PartWalls(claims, context.datum.box)
        contours = tuple(claim for claim in claims if claim.segment.key in closed)
        self.faces = tuple(claim for claim in claims if claim.segment.key not in closed)
        self.groups = [
            (walls(some), np.array([claim.tolerance for claim in some]), some is self.faces)
            for some in (contours, self.faces)
            if some
        ]

    def off(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance (N,) [m] of points (N, 3) to the part, negative inside, NaN where it is not known, and the
        tolerance (N,) there. What is outside of either the contours or the faces is outside, and so is what
        is outside of a face that the nearest one crosses: both bound the part together, which is no nearer
        than the farther one of them."""
        off, tolerance = np.full(len(points), -np.inf), np.full(len(points), np.nan)
        for group, limits, are_faces in self.groups:
            here, owner = group.off(points)
            if are_faces:
                here = self._beyond(points, here, owner)
            tolerance = np.where(here > off, limits[owner], tolerance)
            off = np.maximum(off, here)  # NaN remains
        return np.where(np.isinf(off), np.nan, off), tolerance

    def _beyond(self, points: FloatArray, off: FloatArray, owner: IntArray) -> FloatArray:
        """Distances (N,) [m] of points (N, 3), where ``off`` is that to the nearest face, ``owner`` (N,)."""
        off = off.copy()
        for number in np.unique(owner[off < BESIDE]).tolist():
            for other in self.walls.crossed(self.faces[number]):
                if any(other is face for face in self.faces):
                    rows = np.flatnonzero((off < BESIDE) & (owner == number))
                    own, _ = self.walls.wall(other).off(points[rows])
                    off[rows] = np.where(own > np.maximum(off[rows], 0.0), own, off[rows])
        return off


def _is_side(context: Context, claim: CutsSurface) -> bool:
    box = context.datum.box
    return bool((np.abs(claim.vertices[:, None] - box[None]).max(axis=0) < SIDE_DISTANCE).any())
