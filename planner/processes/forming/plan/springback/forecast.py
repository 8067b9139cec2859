"""What a forming job springs back by, before anything is formed: curves at control points, issues, exhibits.

Forces are what the user states or a formula for one tool; what a die carries is not known here. So this says
how much too shallow a part will about be, and where; measured forces say it better.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, spread_rows
from planner.geometry.units import DEG, MM, measurement
from planner.issues import Issue, Severity, refusal
from planner.processes.forming.plan.contact import Pass, ToolPath
from planner.processes.forming.plan.process_plan import Work
from planner.processes.forming.plan.springback.control_points import (
    MOST_POINTS,
    ControlPoints,
    control_points,
)
from planner.processes.forming.plan.springback.curves import (
    LOAD_SHARES,
    MORE,
    TRIANGLES,
    Curve,
    PassSpringback,
    Point,
    forces,
    solved,
)

MODES: Final = ("spif", "dsif", "dpif_l", "dpif_p", "heat")
"""Modes of forming in which what is formed springs back as one elastic sheet when the tools let go."""
WHY_NOT: Final = {
    "adsif": "in adsif nothing formed is loaded again, and springback acts otherwise",
    "tpif": "in tpif a die carries the sheet, and no model of that is built in",
}
"""Why the other modes have no forecast."""
TOLD: Final = 0.5
"""Springback [mm] from which a part is called too shallow: what industry asks of such parts."""
LEAST_FORCE_SHARE: Final = 0.01
"""Forces of a pass are at least this share of its largest: where it is flat the formula says 0."""
TRIED: Final = 4
"""Points of each pass at which a sheet is held against a finer one."""
NOT_APART: Final = 0.005 * MM
"""Differences of springback [m] that are none."""
ESTIMATE_TRIANGLES: Final = 1200
"""Triangles of a sheet of which a plan says about how far it comes back."""
ESTIMATE_SHARES: Final = np.array([0.4, 1.0])
"""Loads that it is asked at, over the force that is taken."""
FORMULA: Final = "formula for one tool (Aerens and others), not measured"
"""Where forces come from that nobody states."""
CURVES_SHOWN: Final = 8
"""Curves of a picture at most."""


def require_mode(work: Work) -> None:
    """Raise ``TandemError`` (forming.springback_mode) where a job has no forecast."""
    mode = work.operation.mode
    if mode not in MODES:
        what = f"{work.operation.name}: mode {mode}: {WHY_NOT[mode]}; allowed are {', '.join(MODES)}"
        hint = "form a test piece and measure it"
        raise refusal("forming.springback_mode", what, field="mode", hint=hint)
    if work.staged:
        what = f"{work.operation.name}: the sheet is formed in stages, or was cut before; what it springs "
        what += "back by is known of whole sheets that one operation forms"
        hint = "form a test piece and measure it"
        raise refusal("forming.springback_mode", what, field="features", hint=hint)


def not_foretold(work: Work) -> Issue:
    """That a sheet that was formed or cut before has no forecast (forming.springback)."""
    what = (
        f"{work.operation.name}: what it springs back by is not foretold: the sheet was formed or cut before"
    )
    hint = "form a test piece and measure it (tandem scan-fit)"
    return Issue("forming.springback", what, Severity.NOTE, hint=hint)


def forces_told(work: Work) -> list[str]:
    """Which force is taken, and, of two tools, what of the second one's."""
    op = work.operation
    if op.force_n is not None:
        force = f"the force is {op.force_n:g} N everywhere, as force_n states"
    elif op.force_by is None:
        force = f"forces are those of a {FORMULA}"
    elif op.force_by.file is not None:
        force = f"forces are those of {op.force_by.file.name}, by level as measured, of all tools together"
    else:
        force = "the force is by depth, as the table of force_by states"
    if len(op.arms) == 1 or op.mode == "heat" or (op.force_by is not None and op.force_by.file is not None):
        return [force]
    if op.support_force_n is not None:
        return [f"{force}, less the {op.support_force_n:g} N by which the support presses against it"]
    return [force, "all of that bends the sheet: what the other tool carries of it is not stated"]


def points(
    work: Work, laid: Sequence[tuple[Pass, ToolPath]], most: int = MOST_POINTS
) -> list[tuple[ControlPoints, list[Point]]]:
    """Control points of each pass, at most ``most``, and what is to be solved at them."""
    out = []
    for number, (one, path) in enumerate(laid):
        radius, contact = work.heads[work.former(one)].radius, path.contact
        control = control_points(contact.point, contact.angle, contact.loop, radius, most)
        force = forces(work, one, control.point, control.angle)
        force = np.maximum(force, LEAST_FORCE_SHARE * float(force.max()))
        around = _around(control, contact.loop, forces(work, one, contact.point, contact.angle))
        rows = [
            Point(number, place, float(n), float(around[level]))
            for place, n, level in zip(control.point, force, control.level, strict=True)
        ]
        out.append((control, rows))
    return out


def _around(control: ControlPoints, loop: IntArray, force: FloatArray) -> FloatArray:
    """The largest force (L,) [N] on the loops from the level above each level to the one below; ``loop`` (N,)
    and ``force`` (N,) [N] of the path's targets."""
    ends = np.concatenate([control.loop[:1], control.loop, control.loop[-1:]])
    pairs = zip(ends[:-2], ends[2:], strict=True)
    return np.array([float(force[(loop >= low) & (loop <= high)].max()) for low, high in pairs])


def along(work: Work, found: PassSpringback, points: FloatArray, angle: FloatArray) -> FloatArray:
    """Springback (N,) [m] at places (N, 3) [m] along the contact of a pass, on walls at ``angle`` (N,) [rad],
    under the force there, which is no smaller than where it is flat."""
    force = forces(work, found.one, points, angle)
    return found.at(points, np.maximum(force, LEAST_FORCE_SHARE * float(found.force.max())))


def some_points(control: Sequence[tuple[ControlPoints, Sequence[Point]]]) -> list[Point]:
    """Points of each pass at which a sheet is held against a finer one, from its first level to its last."""
    out = []
    for _, every in control:
        out += [every[k] for k in spread_rows(len(every), TRIED)]
    return out


def apart(some: Sequence[Point], found: Sequence[Curve], other: Sequence[Curve]) -> float:
    """The largest share by which places come back by other than with ``other`` curves, under their forces,
    but for `NOT_APART`; 0 where both snap."""
    back = np.array(
        [[curve.at(point.force) for curve in pair] for point, *pair in zip(some, found, other, strict=True)]
    )
    snaps = np.isnan(back)
    if (snaps[:, 0] != snaps[:, 1]).any():
        return float("inf")
    off = np.maximum(np.abs(back[:, 0] - back[:, 1]) - NOT_APART, 0.0) / back[:, 1]
    return float(np.nan_to_num(off).max(initial=0.0))


def curves(
    work: Work, some: Sequence[Point], triangles: int = TRIANGLES, shares: FloatArray = LOAD_SHARES
) -> Iterator[Curve]:
    """The curves at some points, at ``shares`` of their forces, one after the other: what a process works
    out. Raises ``TandemError`` (forming.springback_mesh)."""
    for point in some:
        try:
            found = solved(work, point, triangles, shares)
        except ValueError as error:
            what = (
                f"pass {work.passes[point.number].name}: the sheet as formed at z = "
                f"{point.place[2] / MM:.2f} mm has no mesh: {error}"
            )
            hint = f"allow more triangles: {int(2.0 * MORE[-1] * triangles)}"
            raise refusal("forming.springback_mesh", what, field="triangles", hint=hint) from error
        yield found


def forecast(
    laid: Sequence[tuple[Pass, ToolPath]],
    control: Sequence[tuple[ControlPoints, list[Point]]],
    found: Sequence[Curve],
) -> tuple[PassSpringback, ...]:
    """Springback of each pass, from the ``found`` curves of all points in their order."""
    out, begun = [], 0
    for (one, _), (where, rows) in zip(laid, control, strict=True):
        mine = tuple(found[begun : begun + len(rows)])
        begun += len(rows)
        force = np.array([row.force for row in rows])
        under = np.array([float(curve.at(n)) for curve, n in zip(mine, force, strict=True)])
        out.append(PassSpringback(one, where, mine, force, under))
    return tuple(out)


def issues(found: Sequence[PassSpringback]) -> list[Issue]:
    """What of a forecast the user must know: forming.springback, forming.limit_load."""
    out: list[Issue] = []
    worst = max(found, key=lambda one: float(np.nanmax(one.springback, initial=0.0)))
    most = float(np.nanmax(worst.springback, initial=0.0)) / MM
    if most > TOLD:
        at = int(np.nanargmax(worst.springback))
        z = worst.control.point[at, 2] / MM
        mean = float(np.nanmean(worst.springback)) / MM
        what = f"pass {worst.one.name}: when the tool lets go the sheet comes back by up to {most:.2f} mm "
        what += f"(at z = {z:.1f} mm, under {worst.force[at]:.0f} N), by {mean:.2f} mm in the mean of its "
        what += f"control points: so much too shallow the part will be, {TOLD:g} mm are not told"
        hint = "hold the sheet nearer to the part (opening_mm) or more firmly (clamp: border), take thicker "
        hint += "sheet, or state a measured force_n"
        out.append(
            Issue("forming.springback", what, Severity.WARNING, **measurement(most, TOLD, "mm"), hint=hint)
        )
    for one in found:
        snaps = np.flatnonzero(np.isnan(one.springback))
        if len(snaps):
            reached = one.curves[snaps[0]].force[-1]
            least = LOAD_SHARES[0] * one.force[snaps[0]]
            holds = f"holds {reached:.0f} N" if reached > 0.0 else f"does not hold {least:.0f} N"
            out.append(
                Issue(
                    "forming.limit_load",
                    f"pass {one.one.name}: at z = {one.control.point[snaps[0], 2] / MM:.1f} mm the sheet "
                    f"{holds}, {one.force[snaps[0]]:.0f} N are expected; beyond, it snaps "
                    f"or buckles",
                    Severity.WARNING,
                    **measurement(float(one.force[snaps[0]]), float(reached), "N"),
                    hint="hold the sheet nearer to the part, form in more passes, or take thicker sheet",
                )
            )
    return out


@dataclasses.dataclass(frozen=True)
class Estimate:
    """Springback of pass ``number`` of a plan at the targets ``rows`` of its path: ``springback`` each [m],
    under the ``force`` [N], which is ``assumed`` where the user states none."""

    number: int
    rows: tuple[int, ...]
    springback: tuple[float, ...]
    force: tuple[float, ...]
    assumed: bool

    def under(self, force: Sequence[float]) -> str:
        """Some of its forces [N] in words, from the least to the largest."""
        low, high = min(force), max(force)
        said = f"{high:.0f} N" if round(low) == round(high) else f"{low:.0f} to {high:.0f} N"
        return f"an assumed force of {said} ({FORMULA})" if self.assumed else said


def estimate(work: Work, laid: Sequence[tuple[Pass, ToolPath]]) -> Estimate | None:
    """What a plan says of springback: two places of the deepest pass, on coarse sheets; some half a second a
    place. None where the mode has no forecast; without places where the sheet snaps or is too coarse, of
    which `tandem springback` says what to do."""
    if work.operation.mode not in MODES:
        return None
    number = int(np.argmax([abs(one.end - one.start) for one in work.passes]))
    one, contact = laid[number][0], laid[number][1].contact
    force = forces(work, one, contact.point, contact.angle)
    last = int(contact.loop.max())
    found: dict[int, float] = {}
    for loop in sorted({last // 2, last}):
        rows = np.flatnonzero(contact.loop == loop)
        row = int(rows[np.argmax(force[rows])])
        if force[row] <= 0.0:
            continue
        try:
            curve = solved(
                work, Point(number, contact.point[row], force[row]), ESTIMATE_TRIANGLES, ESTIMATE_SHARES
            )
        except ValueError:
            continue
        if not curve.snaps:
            found[row] = float(curve.springback[-1])
    under = tuple(float(force[row]) for row in found)
    return Estimate(number, tuple(found), tuple(found.values()), under, work.stated is None)


def estimate_issues(work: Work, laid: Sequence[tuple[Pass, ToolPath]], found: Estimate) -> list[Issue]:
    """What the user must know of an estimate (forming.springback)."""
    one, path = laid[found.number]
    field = "force_n" if work.operation.force_by is None else "force_by"
    if not found.rows:
        what = f"pass {one.name}: springback was not estimated: the sheet has no coarse mesh, or it snaps"
        hint = "see tandem springback"
        return [Issue("forming.springback", what, Severity.WARNING, field=field, hint=hint)]
    most, row, force = max(zip(found.springback, found.rows, found.force, strict=True))
    most /= MM
    if most <= TOLD:
        return []
    x, y, z = path.contact.point[row] / MM
    count = len(found.rows)
    what = (
        f"pass {one.name}: when the tool lets go the sheet will come back by about {most:.1f} mm at "
        f"({x:.1f}, {y:.1f}, {z:.1f}) mm under {found.under([force])}: so much too shallow the part "
        f"will be; estimated at {count} place{'s' * (count > 1)}, of {TOLD:g} mm and less nothing is told"
    )
    hint = "tandem springback says it all over the part; --write makes a file that springback: takes"
    if work.staged:
        hint = "of a sheet that is formed in stages no file makes up for it: form a test piece and measure it"
    if found.assumed:
        hint = f"state a measured force (force_n, force_by), for which another figure may come out; {hint}"
    return [
        Issue(
            "forming.springback",
            what,
            Severity.WARNING,
            field=field,
            **measurement(most, TOLD, "mm"),
            hint=hint,
        )
    ]


def rows(found: Sequence[PassSpringback]) -> list[dict[str, Any]]:
    """The forecast as data, a row for each control point: lengths in mm, forces in N, S = a F^b in mm."""
    out = []
    for one in found:
        for k, curve in enumerate(one.curves):
            a, b = curve.power_law() if len(curve.force) > 2 else (np.nan, np.nan)
            x, y, z = one.control.point[k] / MM
            out.append(
                {
                    "pass": one.one.name,
                    "level": int(one.control.level[k]),
                    "cluster": int(one.control.cluster[k]),
                    "x_mm": round(float(x), 3) + 0.0,
                    "y_mm": round(float(y), 3) + 0.0,
                    "z_mm": round(float(z), 3) + 0.0,
                    "wall_deg": round(float(one.control.angle[k]) / DEG, 2),
                    "force_n": round(float(one.force[k]), 1),
                    "springback_mm": round(float(one.springback[k]) / MM, 4),
                    "a": float(f"{a / MM:.4g}"),
                    "b": round(b, 4),
                    "forces_n": [round(float(n), 1) for n in curve.force],
                    "displacements_mm": [round(float(s) / MM, 4) for s in curve.springback],
                }
            )
    return out


def exhibits(found: Sequence[PassSpringback]) -> dict[str, Any]:
    """Curves and clusters by name, in the forms that the report knows."""
    return {"springback_curves": _curves(found), "clusters": _clusters(found)}


def _curves(found: Sequence[PassSpringback]) -> dict[str, Any]:
    named = [
        (f"{one.one.name}, z {one.control.point[k, 2] / MM:.1f} mm", one.curves[k], one.force[k])
        for one in found
        for k in range(len(one.curves))
        if one.control.cluster[k] == 0
    ]
    chosen = spread_rows(len(named), CURVES_SHOWN)
    series = []
    for colour, k in enumerate(chosen):
        name, curve, expected = named[k]
        x = np.linspace(0.0, float(curve.force[-1]), 60)
        at = np.array([expected])
        drawn = [(x, curve.at(x), ""), (at, curve.at(at), "dots")]
        if len(curve.force) > 2:
            a, b = curve.power_law()
            name += f": {a / MM:.3g} F^{b:.2f}"
            drawn.append((x, a * x**b, "dashed"))
        series += [
            {"name": name, "x": n, "y": s / MM, "colour": colour, "style": style} for n, s, style in drawn
        ]
    return {
        "kind": "curve",
        "title": "Springback over force",
        "note": "lines: the elastic sheet; dashed: S = a F^b, fitted; dots: under the force that is expected",
        "x_label": "force along z [N]",
        "y_label": "springback [mm]",
        "series": tuple(series),
    }


def _clusters(found: Sequence[PassSpringback]) -> dict[str, Any]:
    lines: list[FloatArray] = []
    number: list[float] = []
    for one in found:
        for ring in one.control.rings:
            for cluster in range(int(ring.label.max()) + 1):
                inside = np.flatnonzero(ring.label == cluster)
                gap = np.flatnonzero(np.diff(inside) > 1)
                inside = np.roll(inside, -(gap[0] + 1)) if len(gap) else inside
                if len(inside) > 1:
                    lines.append(ring.point[inside])
                    number.append(float(cluster))
    return {
        "kind": "paths",
        "title": "Loops by the parts that a control point stands for",
        "curves": lines,
        "value": np.array(number),
        "value_name": "number of the part on its loop",
        "points": np.concatenate([one.control.point for one in found]),
        "near": True,
        "note": "dots: control points",
    }
