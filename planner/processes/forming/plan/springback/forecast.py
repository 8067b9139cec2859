"""Springback forecast of a forming job: curves at control points, issues, exhibits.

It is made before anything is formed. Forces are stated by the user or follow from a formula for one tool; the
share of a die is not known. So the forecast shows approximately how much too shallow a part will be, and
where. Measured forces improve it.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, spread_rows
from planner.geometry.units import DEG, MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, Severity, issue_error
from planner.processes.forming.plan.contact import FormingPass, FormingToolPath
from planner.processes.forming.plan.process_plan import FormingWork
from planner.processes.forming.plan.springback.control_points import (
    MAX_CONTROL_POINTS,
    ControlPoints,
    choose_control_points,
)
from planner.processes.forming.plan.springback.curves import (
    LOAD_FACTORS,
    MAX_TRIANGLES,
    TRIANGLE_FACTORS,
    PassSpringback,
    SpringbackCurve,
    SpringbackPoint,
    sheet_forces,
    solve_curve,
)

FORECAST_MODES: Final = ("spif", "dsif", "dpif_l", "dpif_p", "heat")
"""Forming modes in which the formed sheet springs back as one elastic sheet when the tools release it."""
NO_FORECAST_REASONS: Final = {
    "adsif": "in adsif formed sheet is not loaded again, and springback acts differently",
    "tpif": "in tpif a die carries the sheet, which is not modelled",
}
"""Reason why the other modes have no forecast."""
REPORTED_SPRINGBACK_MM: Final = 0.5
"""Springback [mm] from which a part is reported as too shallow: the accuracy that industry requires of such
parts.
"""
MIN_FORCE_FRACTION: Final = 0.01
"""Minimum force of a pass as a fraction of its largest one: where the sheet is flat the formula gives 0."""
COMPARED_POINTS: Final = 4
"""Number of points of each pass at which a sheet is compared with a finer one."""
SPRINGBACK_TOLERANCE_M: Final = 0.005 * MM
"""Differences of springback [m] up to this are negligible."""
ESTIMATE_TRIANGLES: Final = 1200
"""Number of triangles of the sheet for the approximate springback in a plan."""
ESTIMATE_LOAD_FACTORS: Final = np.array([0.4, 1.0])
"""Loads of that estimate as multiples of the force."""
FORMULA_SOURCE: Final = "formula for one tool (Aerens and others), not measured"
"""Origin of forces that are not stated."""
MAX_SHOWN_CURVES: Final = 8
"""Maximum number of curves in a picture."""


def require_forecast_mode(work: FormingWork) -> None:
    """Check that a job has a forecast.

    Raises:
        TandemError: forming.springback_mode.
    """
    mode = work.operation.mode
    if mode not in FORECAST_MODES:
        message = (
            f"{work.operation.name}: mode {mode}: {NO_FORECAST_REASONS[mode]}; allowed are "
            f"{', '.join(FORECAST_MODES)}"
        )
        hint = "form a test piece and measure it"
        raise issue_error("forming.springback_mode", message, field="mode", hint=hint)
    if work.staged:
        message = f"{work.operation.name}: the sheet is formed in stages, or was cut before; springback is "
        message += "predicted only for whole sheets that one operation forms"
        hint = "form a test piece and measure it"
        raise issue_error("forming.springback_mode", message, field="features", hint=hint)


def no_forecast_note(work: FormingWork) -> Issue:
    """Return the note that a sheet that was formed or cut before has no forecast (forming.springback)."""
    message = (
        f"{work.operation.name}: springback is not predicted, because the sheet was formed or cut before"
    )
    hint = "form a test piece and measure it (tandem scan-fit)"
    return Issue("forming.springback", message, Severity.NOTE, hint=hint)


def describe_forces(work: FormingWork) -> list[str]:
    """Describe the force that is used and, for two tools, the share of the second one."""
    op = work.operation
    if op.force_n is not None:
        force = f"the force is {op.force_n:g} N everywhere, as force_n states"
    elif op.force_by is None:
        force = f"forces are those of a {FORMULA_SOURCE}"
    elif op.force_by.file is not None:
        force = f"forces are those of {op.force_by.file.name}, by level as measured, of all tools together"
    else:
        force = "the force is by depth, as the table of force_by states"
    if len(op.arms) == 1 or op.mode == "heat" or (op.force_by is not None and op.force_by.file is not None):
        return [force]
    if op.support_force_n is not None:
        return [f"{force}, minus the {op.support_force_n:g} N with which the support presses against it"]
    return [force, "all of that bends the sheet, because the share of the other tool is not stated"]


def forecast_points(
    work: FormingWork,
    paths: Sequence[tuple[FormingPass, FormingToolPath]],
    max_points: int = MAX_CONTROL_POINTS,
) -> list[tuple[ControlPoints, list[SpringbackPoint]]]:
    """Return the control points of each pass, and the points with forces at which springback is solved.

    Args:
        work: Work of the operation.
        paths: Passes with their tool paths.
        max_points: Maximum number of points of each pass.
    """
    out = []
    for number, (forming_pass, path) in enumerate(paths):
        radius = work.heads[work.forming_arm(forming_pass)].radius
        contact = path.contact
        control = choose_control_points(contact.point, contact.angle, contact.loop, radius, max_points)
        force = sheet_forces(work, forming_pass, control.point, control.angle)
        force = np.maximum(force, MIN_FORCE_FRACTION * float(force.max()))
        nearby_force = _nearby_force(
            control, contact.loop, sheet_forces(work, forming_pass, contact.point, contact.angle)
        )
        pass_points = [
            SpringbackPoint(number, contact_point, float(expected_force), float(nearby_force[level]))
            for contact_point, expected_force, level in zip(control.point, force, control.level, strict=True)
        ]
        out.append((control, pass_points))
    return out


def _nearby_force(control: ControlPoints, loop: IntArray, force: FloatArray) -> FloatArray:
    """Return, for each level with control points, the largest force (L,) [N] on its loop and those nearby.

    Nearby are the loops from the previous level with control points to the next one, both included. ``loop``
    (N,) and ``force`` (N,) [N] are those of the path's targets.
    """
    ends = np.concatenate([control.loop[:1], control.loop, control.loop[-1:]])
    neighbours = zip(ends[:-2], ends[2:], strict=True)
    return np.array([float(force[(loop >= low) & (loop <= high)].max()) for low, high in neighbours])


def springback_along(
    work: FormingWork, springback: PassSpringback, points: FloatArray, angle: FloatArray
) -> FloatArray:
    """Return the springback (N,) [m] along the contact of a pass, under the force there.

    The force is at least `MIN_FORCE_FRACTION` of the largest one, as at the control points.

    Args:
        work: Work of the operation.
        springback: Springback of the pass.
        points: Points (N, 3) [m].
        angle: Wall angles (N,) [rad].
    """
    force = sheet_forces(work, springback.forming_pass, points, angle)
    return springback.at(points, np.maximum(force, MIN_FORCE_FRACTION * float(springback.force.max())))


def comparison_points(
    control: Sequence[tuple[ControlPoints, Sequence[SpringbackPoint]]],
) -> list[SpringbackPoint]:
    """Return points of each pass at which a sheet is compared with a finer one.

    They are spread from the first level of the pass to its last.
    """
    out = []
    for _, pass_points in control:
        out += [pass_points[k] for k in spread_rows(len(pass_points), COMPARED_POINTS)]
    return out


def max_relative_difference(
    points: Sequence[SpringbackPoint], curves: Sequence[SpringbackCurve], other: Sequence[SpringbackCurve]
) -> float:
    """Return the largest relative difference of springback from ``other`` curves, under the points' forces.

    Differences up to `SPRINGBACK_TOLERANCE_M` do not count. A point at which both sheets snap counts as 0.
    The result is infinite if only one of them snaps somewhere.
    """
    back = np.array(
        [
            [curve.at(point.force) for curve in pair]
            for point, *pair in zip(points, curves, other, strict=True)
        ]
    )
    snaps = np.isnan(back)
    if (snaps[:, 0] != snaps[:, 1]).any():
        return float("inf")
    difference = np.maximum(np.abs(back[:, 0] - back[:, 1]) - SPRINGBACK_TOLERANCE_M, 0.0) / back[:, 1]
    return float(np.nan_to_num(difference).max(initial=0.0))


def solve_curves(
    work: FormingWork,
    selected: Sequence[SpringbackPoint],
    triangles: int = MAX_TRIANGLES,
    shares: FloatArray = LOAD_FACTORS,
) -> Iterator[SpringbackCurve]:
    """Yield the curves at some points, one after the other, as one process calculates them.

    Args:
        work: Work of the operation.
        selected: Points.
        triangles: Maximum number of triangles.
        shares: Loads as multiples of the expected forces.

    Raises:
        TandemError: forming.springback_mesh if the sheet cannot be meshed.
    """
    for point in selected:
        try:
            curve = solve_curve(work, point, triangles, shares)
        except ValueError as error:
            message = format_message(
                "forming.springback_mesh",
                pass_name=work.passes[point.number].name,
                z_mm=point.contact[2] / MM,
                error=error,
            )
            hint = f"allow more triangles: {int(2.0 * TRIANGLE_FACTORS[-1] * triangles)}"
            raise issue_error("forming.springback_mesh", message, field="triangles", hint=hint) from error
        yield curve


def make_forecast(
    paths: Sequence[tuple[FormingPass, FormingToolPath]],
    control: Sequence[tuple[ControlPoints, list[SpringbackPoint]]],
    curves: Sequence[SpringbackCurve],
) -> tuple[PassSpringback, ...]:
    """Return the springback of each pass.

    Args:
        paths: Passes with their tool paths.
        control: Control points of each pass, and the points that were solved at them.
        curves: Curves of all points, in the order of passes and points.
    """
    out, offset = [], 0
    for (forming_pass, _), (control_points, pass_points) in zip(paths, control, strict=True):
        pass_curves = tuple(curves[offset : offset + len(pass_points)])
        offset += len(pass_points)
        force = np.array([point.force for point in pass_points])
        springback = np.array([float(curve.at(load)) for curve, load in zip(pass_curves, force, strict=True)])
        out.append(PassSpringback(forming_pass, control_points, pass_curves, force, springback))
    return tuple(out)


def forecast_issues(forecasts: Sequence[PassSpringback]) -> list[Issue]:
    """Return warnings about a forecast: the largest springback, and points at which the sheet snaps.

    There is at most one warning forming.springback, for the largest value above REPORTED_SPRINGBACK_MM, and
    one warning forming.limit_load for each pass with points at which the sheet does not bear the force.
    """
    out: list[Issue] = []
    worst_pass = max(forecasts, key=lambda item: float(np.nanmax(item.springback, initial=0.0)))
    max_mm = float(np.nanmax(worst_pass.springback, initial=0.0)) / MM
    if max_mm > REPORTED_SPRINGBACK_MM:
        worst_index = int(np.nanargmax(worst_pass.springback))
        z = worst_pass.control.point[worst_index, 2] / MM
        mean = float(np.nanmean(worst_pass.springback)) / MM
        message = (
            f"pass {worst_pass.forming_pass.name}: the sheet springs back by up to {max_mm:.2f} mm when the "
            "tool releases "
        )
        message += (
            f"it (at z = {z:.1f} mm, under {worst_pass.force[worst_index]:.0f} N), by {mean:.2f} mm on "
            "average over "
        )
        message += (
            "its control points; the part will be too shallow by that (reported above "
            f"{REPORTED_SPRINGBACK_MM:g} mm)"
        )
        hint = "clamp the sheet nearer to the part (opening_mm) or more firmly (clamp: border), use thicker "
        hint += "sheet, or state a measured force_n"
        out.append(
            Issue(
                "forming.springback",
                message,
                Severity.WARNING,
                **measurement(max_mm, REPORTED_SPRINGBACK_MM, "mm"),
                hint=hint,
            )
        )
    for item in forecasts:
        snaps = np.flatnonzero(np.isnan(item.springback))
        if len(snaps):
            max_force = item.curves[snaps[0]].force[-1]
            first_load = LOAD_FACTORS[0] * item.force[snaps[0]]
            holds = f"holds {max_force:.0f} N" if max_force > 0.0 else f"does not hold {first_load:.0f} N"
            out.append(
                Issue(
                    "forming.limit_load",
                    f"pass {item.forming_pass.name}: at z = {item.control.point[snaps[0], 2] / MM:.1f} mm "
                    f"the sheet {holds}, {item.force[snaps[0]]:.0f} N are expected; beyond that it "
                    "snaps or buckles",
                    Severity.WARNING,
                    **measurement(float(item.force[snaps[0]]), float(max_force), "N"),
                    hint="clamp the sheet nearer to the part, form in more passes, or use thicker sheet",
                )
            )
    return out


@dataclasses.dataclass(frozen=True)
class SpringbackEstimate:
    """Estimated springback of one pass of a plan.

    Attributes:
        number: Number of the pass.
        rows: Indices of the targets of its path at which springback was estimated.
        springback: Springback [m] at each of them.
        force: Force [N] at each of them.
        assumed: Whether the forces follow from the formula.
    """

    number: int
    rows: tuple[int, ...]
    springback: tuple[float, ...]
    force: tuple[float, ...]
    assumed: bool

    def force_text(self, force: Sequence[float]) -> str:
        """Return the range of some of its forces [N] in words, with their origin if they are assumed."""
        low, high = min(force), max(force)
        text = f"{high:.0f} N" if round(low) == round(high) else f"{low:.0f} to {high:.0f} N"
        return f"an assumed force of {text} ({FORMULA_SOURCE})" if self.assumed else text


def estimate_springback(
    work: FormingWork, paths: Sequence[tuple[FormingPass, FormingToolPath]]
) -> SpringbackEstimate | None:
    """Estimate springback for a plan at two points of the deepest pass, on coarse meshes.

    The points are those under the largest force on the middle loop and on the last loop. A point takes about
    half a second.

    Returns:
        Estimate, or None if the mode has no forecast. Points at which the sheet snaps, or for which the mesh
        is too coarse, are left out, so the estimate may be empty; `tandem springback` reports the remedy.
    """
    if work.operation.mode not in FORECAST_MODES:
        return None
    number = int(np.argmax([abs(forming_pass.end - forming_pass.start) for forming_pass in work.passes]))
    forming_pass, path = paths[number]
    contact = path.contact
    force = sheet_forces(work, forming_pass, contact.point, contact.angle)
    last_loop = int(contact.loop.max())
    springback: dict[int, float] = {}
    for loop in sorted({last_loop // 2, last_loop}):
        targets = np.flatnonzero(contact.loop == loop)
        target = int(targets[np.argmax(force[targets])])
        if force[target] <= 0.0:
            continue
        try:
            curve = solve_curve(
                work,
                SpringbackPoint(number, contact.point[target], force[target]),
                ESTIMATE_TRIANGLES,
                ESTIMATE_LOAD_FACTORS,
            )
        except ValueError:
            continue
        if not curve.snaps:
            springback[target] = float(curve.springback[-1])
    target_forces = tuple(float(force[target]) for target in springback)
    return SpringbackEstimate(
        number, tuple(springback), tuple(springback.values()), target_forces, work.stated_forces is None
    )


def estimate_issues(
    work: FormingWork, paths: Sequence[tuple[FormingPass, FormingToolPath]], estimate: SpringbackEstimate
) -> list[Issue]:
    """Return a warning (forming.springback) if the estimate is empty or above REPORTED_SPRINGBACK_MM."""
    forming_pass, path = paths[estimate.number]
    field = "force_n" if work.operation.force_by is None else "force_by"
    if not estimate.rows:
        message = (
            f"pass {forming_pass.name}: springback was not estimated, because the sheet has no coarse mesh "
            "or snaps"
        )
        hint = "see tandem springback"
        return [Issue("forming.springback", message, Severity.WARNING, field=field, hint=hint)]
    max_mm, target, force = max(zip(estimate.springback, estimate.rows, estimate.force, strict=True))
    max_mm /= MM
    if max_mm <= REPORTED_SPRINGBACK_MM:
        return []
    x, y, z = path.contact.point[target] / MM
    count = len(estimate.rows)
    message = (
        f"pass {forming_pass.name}: the sheet will spring back by about {max_mm:.1f} mm when the tool "
        f"releases it, at ({x:.1f}, {y:.1f}, {z:.1f}) mm under {estimate.force_text([force])}, and the part "
        f"will be too shallow by that; estimated at {count} point{'s' * (count > 1)} (reported above "
        f"{REPORTED_SPRINGBACK_MM:g} mm)"
    )
    hint = "tandem springback calculates it all over the part; --write makes a file for springback:"
    if work.staged:
        hint = "no file can compensate it for a sheet formed in stages: form a test piece and measure it"
    if estimate.assumed:
        hint = f"state a measured force (force_n, force_by), which may change the result; {hint}"
    return [
        Issue(
            "forming.springback",
            message,
            Severity.WARNING,
            field=field,
            **measurement(max_mm, REPORTED_SPRINGBACK_MM, "mm"),
            hint=hint,
        )
    ]


def forecast_rows(forecasts: Sequence[PassSpringback]) -> list[dict[str, Any]]:
    """Return the forecast as data, a row for each control point.

    Lengths are in mm, forces in N, S = a F^b in mm.
    """
    rows = []
    for item in forecasts:
        for k, curve in enumerate(item.curves):
            a, b = curve.power_law() if len(curve.force) > 2 else (np.nan, np.nan)
            x, y, z = item.control.point[k] / MM
            rows.append(
                {
                    "pass": item.forming_pass.name,
                    "level": int(item.control.level[k]),
                    "cluster": int(item.control.cluster[k]),
                    "x_mm": round(float(x), 3) + 0.0,
                    "y_mm": round(float(y), 3) + 0.0,
                    "z_mm": round(float(z), 3) + 0.0,
                    "wall_deg": round(float(item.control.angle[k]) / DEG, 2),
                    "force_n": round(float(item.force[k]), 1),
                    "springback_mm": round(float(item.springback[k]) / MM, 4),
                    "a": float(f"{a / MM:.4g}"),
                    "b": round(b, 4),
                    "forces_n": [round(float(curve_force), 1) for curve_force in curve.force],
                    "displacements_mm": [
                        round(float(curve_springback) / MM, 4) for curve_springback in curve.springback
                    ],
                }
            )
    return rows


def forecast_exhibits(forecasts: Sequence[PassSpringback]) -> dict[str, Any]:
    """Return curves and clusters by name, in the forms that the report knows."""
    return {"springback_curves": _curve_exhibit(forecasts), "clusters": _cluster_exhibit(forecasts)}


def _curve_exhibit(forecasts: Sequence[PassSpringback]) -> dict[str, Any]:
    """Return the exhibit of some curves, those of the first cluster of each level, with their power laws."""
    named_curves = [
        (f"{item.forming_pass.name}, z {item.control.point[k, 2] / MM:.1f} mm", item.curves[k], item.force[k])
        for item in forecasts
        for k in range(len(item.curves))
        if item.control.cluster[k] == 0
    ]
    chosen = spread_rows(len(named_curves), MAX_SHOWN_CURVES)
    series = []
    for colour, k in enumerate(chosen):
        name, curve, expected = named_curves[k]
        x = np.linspace(0.0, float(curve.force[-1]), 60)
        expected_load = np.array([expected])
        drawn_lines = [(x, curve.at(x), ""), (expected_load, curve.at(expected_load), "dots")]
        if len(curve.force) > 2:
            a, b = curve.power_law()
            name += f": {a / MM:.3g} F^{b:.2f}"
            drawn_lines.append((x, a * x**b, "dashed"))
        series += [
            {"name": name, "x": loads, "y": springback / MM, "colour": colour, "style": style}
            for loads, springback, style in drawn_lines
        ]
    return {
        "kind": "curve",
        "title": "Springback over force",
        "note": "lines: the elastic sheet; dashed: S = a F^b, fitted; dots: under the expected force",
        "x_label": "force along z [N]",
        "y_label": "springback [mm]",
        "series": tuple(series),
    }


def _cluster_exhibit(forecasts: Sequence[PassSpringback]) -> dict[str, Any]:
    """Return the exhibit of the loops with control points, divided into their clusters."""
    lines: list[FloatArray] = []
    cluster_numbers: list[float] = []
    for item in forecasts:
        for ring in item.control.rings:
            for cluster in range(int(ring.label.max()) + 1):
                members = np.flatnonzero(ring.label == cluster)
                gap = np.flatnonzero(np.diff(members) > 1)
                # a cluster may pass the start of the ring
                members = np.roll(members, -(gap[0] + 1)) if len(gap) else members
                if len(members) > 1:
                    lines.append(ring.point[members])
                    cluster_numbers.append(float(cluster))
    return {
        "kind": "paths",
        "title": "Loops by the sections that a control point represents",
        "curves": lines,
        "value": np.array(cluster_numbers),
        "value_name": "number of the section on its loop",
        "points": np.concatenate([item.control.point for item in forecasts]),
        "near": True,
        "note": "dots: control points",
    }
