"""The rule on the cut surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.issues import Issue
from planner.verify.context import Context, Outcome, mm
from planner.verify.result import CutFace
from planner.verify.surface import cut_face, part_obj
from planner.verify.wire import Wire

FloatArray = NDArray[np.float64]

_NEIGHBOURS = 48


def sweeps(context: Context, wires: tuple[Wire, ...]) -> tuple[FloatArray, ...]:
    """The wire's shapes (T, P, 3) in the segment of each wanted face."""
    out = []
    for claim in context.surfaces:
        rows = [wire.points[_during(wire.labels == claim.segment)] for wire in wires if wire.path is not None]
        rows = [row for row in rows if len(row)]
        out.append(np.concatenate(rows) if rows else np.zeros((0, 2, 3)))
    return tuple(out)


def _during(chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Chosen stations and the one before each run of them, where the segment begins."""
    out = chosen.copy()
    out[:-1] |= chosen[1:]
    return out


def surface(context: Context, rows: tuple[FloatArray, ...]) -> tuple[Outcome, tuple[CutFace, ...], str]:
    """The cut surface is within tolerance of the wanted one for the wanted share of it."""
    faces = tuple(cut_face(claim, row) for claim, row in zip(context.surfaces, rows, strict=True))
    issues = []
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
                    field=face.segment,
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
                    field=face.segment,
                    value=100 * missed,
                    limit=100 * (1 - face.wanted_share),
                    unit="%",
                )
            )
    if not faces:
        return Outcome(where="no face is claimed"), (), ""
    worst = min(faces, key=lambda face: face.share - face.wanted_share)
    outcome = Outcome(
        tuple(issues), 100 * worst.share, 100 * worst.wanted_share, "% within tolerance", worst.segment
    )
    return outcome, faces, part_obj(context.surfaces, rows)


def ridges(faces: tuple[CutFace, ...]) -> Outcome:
    """No ridge or groove stands out of the cut surface around it by more than the tolerance."""
    issues, worst, limit = [], 0.0, None
    for face in faces:
        known = np.flatnonzero(np.isfinite(face.deviation))
        if len(known) <= _NEIGHBOURS:
            continue
        points, deviation = face.points[known], face.deviation[known]
        _, near = cKDTree(points).query(points, k=_NEIGHBOURS)
        out = np.abs(deviation - np.median(deviation[near], axis=1))
        k = int(np.argmax(out))
        if limit is None or out[k] > worst:
            worst, limit = float(out[k]), mm(face.tolerance)
        if out[k] > face.tolerance:
            at = ", ".join(f"{value:.1f}" for value in points[k] * 1e3)
            message = (
                f"a ridge or groove of {mm(out[k]):.3f} mm stands out of {face.segment} at ({at}) mm; "
                f"allowed: {mm(face.tolerance):g} mm"
            )
            issues.append(
                Issue(
                    "verify.ridge",
                    message,
                    field=face.segment,
                    value=mm(out[k]),
                    limit=mm(face.tolerance),
                    unit="mm",
                )
            )
    return Outcome(tuple(issues), mm(worst), limit, "mm", "" if faces else "no face is claimed")
