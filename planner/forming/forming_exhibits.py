"""What the report shows of a forming job: features, wall angle and thickness, paths, gap, the setup sheet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from planner.forming.forming_check import force
from planner.forming.forming_claims import scallop
from planner.forming.thickness import thickness_map, thinnest, wall_angle_map
from planner.forming.values import Pass, ToolPath
from planner.forming.work import Work
from planner.units import DEG, MM

FloatArray = NDArray[np.float64]
Laid = Sequence[tuple[Pass, ToolPath]]

SHOWN: Final = 60
"""Loops that the picture of a path shows at most."""


def exhibits(work: Work, paths: Laid) -> dict[str, Any]:
    """Exhibits by name, in the forms that the report knows."""
    out: dict[str, Any] = {
        "setup": _setup(work, paths),
        "features": _features(work),
        "passes": _passes(work, paths),
        "wall_angle": _map(
            work, "Wall angle", wall_angle_map(work.mesh.vertices, work.mesh.faces) / DEG, "deg"
        ),
        "thickness": _map(
            work,
            "Thickness by the sine law",
            thickness_map(work.mesh.vertices, work.mesh.faces, work.thickness) / MM,
            "mm",
        ),
        "paths": _paths(paths),
    }
    if any(np.isfinite(path.gap).any() for _, path in paths):
        out["gap"] = _gap(work, paths)
    return out


def _setup(work: Work, paths: Laid) -> dict[str, Any]:
    op, thin = work.operation, thinnest(work.mesh.vertices, work.mesh.faces, work.thickness)
    largest = max((force(work, one, path) for one, path in paths), key=lambda found: found.force)
    items: list[tuple[Any, ...]] = [
        ("sheet", f"{work.thickness / MM:g} mm {work.sheet.metal.title}"),
        ("mode", op.mode),
        *((f"tool of arm {arm}", _tool(work, arm)) for arm in op.arms),
        ("TCP of a ball tool", "the centre of its ball, z out of the shaft"),
        ("feed on the sheet", f"{op.feed_mm_s:g}", "mm/s"),
        ("thinnest place", f"{thin.thickness / MM:.2f} mm, wall of {thin.angle / DEG:.1f} deg"),
        ("largest axial force", f"{largest.force:.0f} N ({largest.low:.0f} to {largest.high:.0f})"),
        ("source of the force", largest.source),
    ]
    return {"kind": "setup", "title": "Sheet forming", "items": items}


def _tool(work: Work, arm: str) -> str:
    head = work.heads[arm]
    return f"{head.kind}, radius {head.radius / MM:g} mm, {head.length / MM:g} mm from holder to TCP"


def _features(work: Work) -> dict[str, Any]:
    names, parents = ["sheet"], [-1]
    for feature in work.tree.features:
        way = "down" if feature.kind == "concave" else "up"
        names.append(
            f"{feature.id}: {way} from {feature.start / MM:.1f} to {feature.end / MM:.1f} mm ({feature.kind})"
        )
        parents.append(0 if feature.parent is None else feature.parent)
    return {"kind": "tree", "title": "Features of the part", "nodes": names, "parent": parents}


def _passes(work: Work, paths: Laid) -> dict[str, Any]:
    rows = []
    for number, (one, path) in enumerate(paths, 1):
        contact, ridge = path.contact, scallop(work, one) / MM
        length = float(np.linalg.norm(np.diff(path.former, axis=0), axis=1).sum())
        rows.append(
            (
                number,
                one.name,
                one.feature,
                work.former(one),
                f"{one.start / MM:.1f} to {one.end / MM:.1f}",
                f"{float(contact.angle.max()) / DEG:.1f}",
                int(contact.loop.max()) + 1,
                len(contact.point),
                f"{length:.1f}",
                f"{ridge.min():.3f} to {ridge.max():.3f}",
                f"{float(one.thickness.min()) / MM:.2f}",
            )
        )
    columns = (
        "pass",
        "name",
        "feature",
        "formed by",
        "z [mm]",
        "steepest [deg]",
        "loops",
        "targets",
        "way [m]",
        "scallop [mm]",
        "thinnest [mm]",
    )
    return {"kind": "table", "title": "Passes in the order of forming", "columns": columns, "rows": rows}


def _map(work: Work, title: str, value: FloatArray, unit: str) -> dict[str, Any]:
    return {"kind": "heatmap", "title": title, "points": work.mesh.vertices, "value": value, "unit": unit}


def _paths(paths: Laid) -> dict[str, Any]:
    """The contact's path, some loops of each pass."""
    curves = []
    for _, path in paths:
        ends = np.flatnonzero(np.diff(path.contact.loop) != 0) + 1
        loops = np.split(path.contact.point, ends)
        step = max(1, int(np.ceil(len(loops) * len(paths) / SHOWN)))
        curves += [loop for loop in loops[::step] if len(loop) > 1]
    return {"kind": "paths", "title": "Path of the contact (some of its loops)", "curves": curves}


def _gap(work: Work, paths: Laid) -> dict[str, Any]:
    gap = np.concatenate([path.gap for _, path in paths])
    got = []
    for one, path in paths:
        other = work.supporter(one)
        if other is None or path.support is None:
            continue
        radii = work.heads[work.former(one)].radius + work.heads[other].radius
        got.append(np.linalg.norm(path.former - path.support, axis=1) - radii)
    return {
        "kind": "curve",
        "title": "Gap between the tools as planned",
        "x": np.arange(len(gap), dtype=float),
        "x_label": "target of a pass",
        "y_label": "gap [mm]",
        "series": ({"name": "wanted", "y": gap / MM}, {"name": "at targets", "y": np.concatenate(got) / MM}),
    }
