"""What the report shows of a bent wire: sections and shapes, figures along the job, the setup sheet, the
sweeps tried.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.geometry.rigid import from_parts
from planner.hotwire.elastic_check import Cut, Figures
from planner.hotwire.elastic_path import Route
from planner.hotwire.elastic_sweep import Sweep
from planner.hotwire.elastic_wires import planar_pose
from planner.hotwire.operation import ElasticWire
from planner.hotwire.wire import Wire

FloatArray = NDArray[np.float64]

_DRAWN = 24


def exhibits(
    op: ElasticWire, wire: Wire, route: Route, cuts: list[Cut], figures: Figures, tried: list[Sweep]
) -> dict[str, Any]:
    """Exhibits by name, in the forms that the report knows."""
    out: dict[str, Any] = {"setup": _setup(op, wire, route)}
    for cut in cuts:
        out[f"sections_{cut.face.name}"] = _sections(cut)
        out[f"residual_{cut.face.name}"] = _residual(cut)
    step = np.arange(len(route.wires), dtype=np.float64)
    out["stability"] = {
        "kind": "curve",
        "title": "Stability of the wire (1 free, 0 snaps)",
        "x": step,
        "x_label": "target",
        "y_label": "margin",
        "series": [
            {"name": "in its plane", "y": figures.in_plane},
            {"name": "out of its plane", "y": figures.out_of_plane},
        ],
        "limits": [{"name": "snaps", "value": 0.0}],
    }
    out["bending"] = {
        "kind": "curve",
        "title": "Largest curvature of the wire",
        "x": step,
        "x_label": "target",
        "y_label": "1/m",
        "series": [{"name": "curvature", "y": figures.curvature}],
        "limits": [{"name": "elastic limit", "value": wire.max_curvature}],
    }
    out["errors"] = {
        "kind": "curve",
        "title": "What moves the wire in the foam",
        "note": "Weight in the plane is part of the planned shape; the line shows by how much it bends "
        "the wire there.",
        "x": step,
        "x_label": "target",
        "y_label": "mm",
        "series": [
            {"name": "by 0.1 mm at the ends", "y": 0.1 * figures.sensitivity},
            {"name": "sag across its plane", "y": 1e3 * figures.sag},
            {"name": "weight in its plane", "x": step[figures.weight_at], "y": 1e3 * figures.weight},
        ],
    }
    if tried:
        out["sweeps"] = {
            "kind": "table",
            "title": "Wires and sweeps tried",
            "columns": (
                "wire",
                "direction [deg from x]",
                "shape [mm]",
                "by end errors [mm]",
                "longest section [mm]",
                "no way",
            ),
            "rows": [
                (
                    "" if s.wire is None else str(s.wire),
                    f"{s.degrees:g}",
                    "" if s.why else f"{s.shape * 1e3:.3f}",
                    "" if s.why else f"{s.hold * 1e3:.3f}",
                    f"{s.longest * 1e3:.0f}",
                    s.why,
                )
                for s in tried
            ],
        }
    return out


def section_points(cut: Cut) -> tuple[FloatArray, FloatArray]:
    """Wanted sections (S, m, 3) and the wires' points abreast of them (S, m, 3), in the stock frame, of
    those planes that meet the face.
    """
    has = cut.sections.length > 0.0
    planes = cut.face.spine.frames(cut.sections.p[has])
    flat = cut.sections.points[has]
    wanted = flat @ np.swapaxes(planes[:, :3, :2], 1, 2) + planes[:, None, :3, 3]
    wires = cut.face.wires(cut.sections.p[has])
    at = wires.shapes().at(cut.fit.foot[has])
    planar = planar_pose(at[..., :3])[..., :3, 3]
    frame = from_parts(wires.frame[:, :3, :3], wires.frame[:, :3, 3])
    points = planar @ np.swapaxes(frame[:, :3, :3], 1, 2) + frame[:, None, :3, 3]
    return wanted, points


def _sections(cut: Cut) -> dict[str, Any]:
    wanted, wires = section_points(cut)
    has = np.nonzero(cut.sections.length > 0.0)[0]
    some = np.unique(np.linspace(0, len(has) - 1, _DRAWN).astype(np.intp))
    return {
        "kind": "sections",
        "title": f"Sections of the {cut.face.name} face and the wire's shapes",
        "curves": wires[some],
        "wanted": wanted[some],
        "value": 1e3 * np.abs(cut.fit.residual[has[some]]).max(axis=1),
        "value_name": "off by",
        "unit": "mm",
    }


def _residual(cut: Cut) -> dict[str, Any]:
    has = cut.sections.length > 0.0
    wanted, _ = section_points(cut)
    return {
        "kind": "heatmap",
        "title": f"Planned wire against the {cut.face.name} face",
        "points": wanted.reshape(-1, 3),
        "value": 1e3 * cut.fit.residual[has].reshape(-1),
        "unit": "mm",
        "limit": max(0.05, float(1e3 * np.abs(cut.fit.residual).max())),
    }


def _setup(op: ElasticWire, wire: Wire, route: Route) -> dict[str, Any]:
    chord, angles = mount_figures(route)
    size = (
        f"{wire.thickness * 1e3:g} mm round"
        if op.chosen.is_round
        else f"{wire.width * 1e3:g} x {wire.thickness * 1e3:g} mm strip"
    )
    return {
        "kind": "setup",
        "title": "Wire",
        "items": [
            ("wire", f"{wire.material.title}, {size}"),
            ("cold length between the clamps", f"{wire.cold_length(op.chosen.length_mm):.1f}", "mm"),
            ("hot length between the clamps", f"{op.chosen.length_mm:.1f}", "mm"),
            ("distance of the clamps at the mount", f"{chord * 1e3:.1f}", "mm"),
            ("angle of the wire at its start, to the chord", f"{angles[0]:.1f}", "deg"),
            ("angle of the wire at its end, to the chord", f"{angles[1]:.1f}", "deg"),
            ("temperature", f"{op.chosen.temperature_c:g}", "C"),
            ("resistance of the hot wire", f"{wire.resistance * op.chosen.length_mm * 1e-3:.2f}", "ohm"),
        ],
    }


def mount_figures(route: Route) -> tuple[float, tuple[float, float]]:
    """Distance of the clamps [m] and the wire's angles [deg] to the chord at its start and end, at the
    mount.
    """
    wire = route.wires[:1]
    shape = wire.shapes(3)
    start, end = shape.start[0], shape.end[0]
    chord = end[:2] - start[:2]
    level = np.arctan2(chord[1], chord[0])
    return float(np.hypot(*chord)), (float(np.rad2deg(start[2] - level)), float(np.rad2deg(end[2] - level)))
