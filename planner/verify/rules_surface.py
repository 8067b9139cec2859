"""The rule on the cut surface."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from planner.claims import CutsSurface
from planner.geometry.vectors import dots
from planner.issues import Issue
from planner.verify.context import Context, Outcome, mm
from planner.verify.findings import at_sample
from planner.verify.result import CutFace
from planner.verify.speed import during, local
from planner.verify.surface import Sweep, cut_face, deepest, part_obj
from planner.verify.unreached import unreached
from planner.verify.wire import Wire, end_error, to_block

FloatArray = NDArray[np.float64]


def sweeps(context: Context, wires: tuple[Wire, ...]) -> tuple[Sweep, ...]:
    """The wire's shapes in the segment of each wanted face."""
    good = [wire for wire in wires if not wire.fault]
    speeds = [local(wire.points, context.motion.time[wire.sample], wire.inside) for wire in good]
    out = []
    for claim in context.surfaces:
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


def surface(context: Context, rows: tuple[Sweep, ...]) -> tuple[Outcome, tuple[CutFace, ...], str]:
    """The cut surface is within tolerance of the wanted one for the wanted share of it, and in that segment
    the wire nowhere runs much deeper into the part."""
    faces = tuple(
        _reachable(context, claim, cut_face(claim, row))
        for claim, row in zip(context.surfaces, rows, strict=True)
    )
    issues = _gouges(context, rows)
    for face in faces:
        if face.share < face.wanted_share:
            message = (
                f"{100 * face.share:.2f} % of {face.segment} are within {mm(face.tolerance):g} mm of the "
                f"wanted surface; wanted: {100 * face.wanted_share:g} % "
                f"(rms {mm(face.rms):.3f} mm, largest {mm(face.largest):.3f} mm)"
            )
            issues.append(
                Issue(
                    "verify.surface",
                    message,
                    field=face.title,
                    value=100 * face.share,
                    limit=100 * face.wanted_share,
                    unit="%",
                )
            )
        area = face.area / max(float(face.area.sum()), 1e-30)
        missed = float(area[~np.isfinite(face.deviation)].sum())
        if missed > 1.0 - face.wanted_share:
            message = f"the wire does not pass over {100 * missed:.2f} % of {face.segment}"
            issues.append(
                Issue(
                    "verify.surface",
                    message,
                    field=face.title,
                    value=100 * missed,
                    limit=100 * (1 - face.wanted_share),
                    unit="%",
                )
            )
    if not faces:
        return Outcome(where="no face is claimed"), (), ""
    worst = min(faces, key=lambda face: face.share - face.wanted_share)
    outcome = Outcome(
        tuple(issues), 100 * worst.share, 100 * worst.wanted_share, "% within tolerance", worst.title
    )
    return outcome, faces, part_obj(context.surfaces, rows, context.rulings)


def _reachable(context: Context, claim: CutsSurface, face: CutFace) -> CutFace:
    """The face with what a round wire cannot reach of it as good as it can be, where so much of it is off
    that this counts."""
    ruled = next((one for one in context.rulings if one.segment == claim.segment), None)
    high = np.flatnonzero(face.deviation > face.tolerance)
    if ruled is None or face.share >= face.wanted_share or not len(high):
        return face
    speed = face.speed[np.isfinite(face.speed)]
    more = unreached(ruled, face.points[high], 0.5 * float(claim.kerf.at(speed).max()))
    good = np.abs(face.deviation) <= face.tolerance
    good[high] = (face.deviation[high] <= more + face.tolerance) & (more <= ruled.left)
    return dataclasses.replace(face, share=float(face.area[good].sum() / max(face.area.sum(), 1e-30)))


def _gouges(context: Context, rows: tuple[Sweep, ...]) -> list[Issue]:
    """Faces into which the wire cuts besides: the nearest sheet of several hides those beneath it. Straight
    wires keep to their rulings all along, which is more."""
    ruled = {claim.segment.key for claim in context.rulings}
    issues = []
    for claim, sweep in zip(context.surfaces, rows, strict=True):
        if len(sweep.points) < 2 or claim.segment.key in ruled:
            continue
        block = context.stock(context.setup_of(claim))
        deep, _ = deepest(claim, sweep, to_block(sweep.points, block) < 0.0)
        limit = GOUGE * claim.tolerance + FLAT
        if deep > limit:
            what = f"the wire runs {mm(deep):.2f} mm deep below {claim.segment}; allowed: {mm(limit):g} mm"
            measure = {"value": mm(deep), "limit": mm(limit), "unit": "mm"}
            issues.append(Issue("verify.surface", what, field=str(claim.segment), **measure))  # type: ignore[arg-type]
    return issues


ERROR_STATIONS = 5
GOUGE = 3.0
"""A wire may run deeper than wanted by so many tolerances, in places."""
FLAT = 3e-4
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


def ridges(context: Context, wires: tuple[Wire, ...]) -> Outcome:
    """No target of a bent wire stands out of the smooth surface that its neighbours make by more than the
    tolerance; a straight one is held against its rulings, which may have edges."""
    issues, worst, limit, where = [], 0.0, None, ""
    nodes = context.motion.node_sample
    ruled = {claim.segment.key for claim in context.rulings}
    for claim in context.surfaces:
        for wire in wires if claim.segment.key not in ruled else ():
            rows = np.flatnonzero((wire.labels == claim.segment.key) & np.isin(wire.sample, nodes))
            if wire.fault or len(rows) < 5:
                continue
            out = _standing_out(wire.points[rows], wire.inside[rows])
            k = int(np.argmax(out))
            if limit is None or out[k] > worst:
                worst, limit, where = float(out[k]), mm(claim.tolerance), str(claim.segment)
            for i in np.flatnonzero(out > claim.tolerance)[:50]:
                message = (
                    f"the wire is {mm(out[i]):.3f} mm off the surface of its neighbours: a ridge or groove; "
                    f"allowed: {mm(claim.tolerance):g} mm"
                )
                measure = (mm(float(out[i])), mm(claim.tolerance), "mm")
                sample = int(wire.sample[rows[i]])
                arm = wire.arms[0]
                issues.append(at_sample("verify.ridge", message, context.motion, arm, sample, measure))
    return Outcome(tuple(issues), mm(worst), limit, "mm", where or "no face is claimed")


def _standing_out(points: FloatArray, inside: NDArray[np.bool_]) -> FloatArray:
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
