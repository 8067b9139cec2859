"""``tandem kerf``, ``align`` and ``features``: data that is needed before a problem can be written.

``tandem kerf fit | width | speed | power``: your own foam from test cuts, and its kerfs. ``tandem align``:
the base of the second robot of a cell, from points that both robots probed. ``tandem features PART``: the
features of a sheet part, printed and drawn.
"""

from __future__ import annotations

import dataclasses
import datetime as dt
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.markup import escape
from rich.table import Table
from rich.tree import Tree

from planner.cli.console import plain_out as out
from planner.cli.console import require_suffix, write_output
from planner.geometry.units import DEG, LENGTH_UNITS, MM
from planner.issues import Issue, TandemError, issue_error

if TYPE_CHECKING:
    from planner.catalogue.materials import FoamMaterial
    from planner.geometry.arrays import Mesh
    from planner.processes.forming.plan.features.tree import Feature, FeatureTree, OrderStep
    from planner.processes.hotwire.plan.kerf.calibration import CutFile, FitReport
    from planner.processes.hotwire.plan.kerf.width import KerfEstimate
    from planner.shopfloor.align.probing import ProbedPoints
    from planner.shopfloor.align.rigid_fit import Alignment


@dataclasses.dataclass(frozen=True)
class FoamFit:
    """Fit a foam of your own from test cuts, and write a foam file for problems.

    The CSV file has the columns power_w, speed_mm_s, and either kerf_mm or measured_side_mm with
    nominal_side_mm; optionally wire_length_mm, thickness_mm, and face (ok, burnt, dragging). Cuts without a
    face are left out if the fit gives them a kerf outside 0.8 to 3 mm.
    """

    tests: tyro.conf.Positional[Path]
    """the file of test cuts, CSV"""
    density_kg_m3: float
    """density of the foam: weigh a block"""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("my_foam.yaml")
    """the foam file to write"""
    name: str = "my_foam"
    """name of the foam: a letter, then letters, digits and underscores"""
    thickness_mm: float | None = None
    """thickness of the foam in the tests, unless it is in the file"""
    wire_length_mm: float | None = None
    """heated length of the wire, unless it is in the file"""
    wire_diameter_mm: float = 0.4
    """diameter of the wire"""
    specific_heat_j_kg_k: float = 1450.0
    """chi compensates an error in it"""
    melt_temperature_c: float = 280.0
    """chi compensates an error in it"""
    conductivity_w_m_k: float | None = None
    """stored in the foam file; the fit does not use it"""


@dataclasses.dataclass(frozen=True)
class _KerfQuery:
    foam: tyro.conf.Positional[str]
    """a built-in foam, or a foam file"""
    thickness_mm: float = 50.0
    """thickness of the foam along the wire"""
    wire_length_mm: float = 430.0
    """heated length of the wire, over which its power is spread"""
    wire_diameter_mm: float = 0.4
    """diameter of the wire"""
    model: Literal["energy", "general", "measured", "dissertation"] = "energy"
    """model to use"""


@dataclasses.dataclass(frozen=True)
class KerfWidth(_KerfQuery):
    """Kerf at a power and a speed."""

    power_w: float = tyro.MISSING
    """power of the whole heated wire"""
    speed_mm_s: float = tyro.MISSING
    """speed of the wire perpendicular to itself"""


@dataclasses.dataclass(frozen=True)
class KerfSpeed(_KerfQuery):
    """Speed for a required kerf at a power."""

    power_w: float = tyro.MISSING
    """power of the whole heated wire"""
    kerf_mm: float = tyro.MISSING
    """required width of the slot"""


@dataclasses.dataclass(frozen=True)
class KerfPower(_KerfQuery):
    """Power for a required kerf at a speed."""

    speed_mm_s: float = tyro.MISSING
    """speed of the wire perpendicular to itself"""
    kerf_mm: float = tyro.MISSING
    """required width of the slot"""


KerfAction = tyro.conf.OmitSubcommandPrefixes[
    Annotated[FoamFit, tyro.conf.subcommand("fit")]
    | Annotated[KerfWidth, tyro.conf.subcommand("width")]
    | Annotated[KerfSpeed, tyro.conf.subcommand("speed")]
    | Annotated[KerfPower, tyro.conf.subcommand("power")]
]


def run_kerf(action: FoamFit | KerfWidth | KerfSpeed | KerfPower) -> None:
    """Print a kerf with its power and speed, or fit a foam and write its file.

    Raises:
        TandemError: ``kerf.*``.
    """
    if isinstance(action, FoamFit):
        _fit_foam(action)
    else:
        _answer_kerf(action)


def _answer_kerf(request: KerfWidth | KerfSpeed | KerfPower) -> None:
    """Compute and print the kerf for a power and a speed, or the speed or power for a kerf."""
    from planner.processes.hotwire.plan.kerf import width as kerf

    foam = _read_foam(request.foam)
    wire = kerf.HotWire(request.wire_diameter_mm * MM, request.wire_length_mm * MM)
    thickness = request.thickness_mm * MM
    if isinstance(request, KerfSpeed):
        power, kerf_width = request.power_w, request.kerf_mm * MM
        speed = float(kerf.speed_for(foam, wire, power, kerf_width, thickness, request.model))
    elif isinstance(request, KerfPower):
        speed, kerf_width = request.speed_mm_s * MM, request.kerf_mm * MM
        power = float(kerf.power_for(foam, wire, speed, kerf_width, thickness, request.model))
    else:
        power, speed = request.power_w, request.speed_mm_s * MM
    _print_kerf(kerf.width(foam, wire, power, speed, thickness, request.model), power, speed)


def _print_kerf(estimate: KerfEstimate, power: float, speed: float) -> None:
    from planner.processes.hotwire.plan.kerf.width import explain

    low, width, high = (float(value) / MM for value in (estimate.low, estimate.width, estimate.high))
    out.print(f"kerf {width:.2f} mm ({low:.2f} to {high:.2f} mm in 9 of 10 cuts)")
    out.print(f"at {power:.1f} W and {speed / MM:.2f} mm/s")
    for text in explain(int(estimate.flag)):
        out.print(f"note: {text}")


def _read_foam(text: str) -> FoamMaterial:
    from planner.catalogue.materials import foam
    from planner.reading import materials as material_file

    return material_file.read_foam(Path(text)) if text.endswith((".yaml", ".yml")) else foam(text)


def _fit_foam(request: FoamFit) -> None:
    """Fit the kerf model of a foam to test cuts, and write the foam file."""
    from planner.processes.hotwire.plan.kerf import calibration
    from planner.reading import materials as material_file

    foam_fields: dict[str, object] = {
        "density_kg_m3": request.density_kg_m3,
        "specific_heat_j_kg_k": request.specific_heat_j_kg_k,
        "melt_temperature_c": request.melt_temperature_c,
        "name": request.name,
    }
    if request.conductivity_w_m_k is not None:
        foam_fields["conductivity_w_m_k"] = request.conductivity_w_m_k
    foam = material_file.make_foam(foam_fields)
    diameter = _metres("wire_diameter_mm", request.wire_diameter_mm)
    length = None if request.wire_length_mm is None else _metres("wire_length_mm", request.wire_length_mm)
    thickness = None if request.thickness_mm is None else _metres("thickness_mm", request.thickness_mm)
    cut_file = calibration.read_cuts(request.tests, diameter, length, thickness)
    report = calibration.fit_robust(foam, cut_file, diameter)
    today = dt.date.today().isoformat()
    source = f"{report.fit.count} of {len(cut_file.cuts)} test cuts in {request.tests.name}, fitted {today}"
    material_file.write_foam(request.output, dataclasses.replace(foam, kerf=report.fit), source)
    _print_fit(report, cut_file, request.output)


def _metres(name: str, value_mm: float) -> float:
    """Convert an option from mm to m. Refuse values that are not positive."""
    if not (math.isfinite(value_mm) and value_mm > 0.0):
        text = f"must be above 0, got {value_mm:g}"
        raise issue_error("kerf.input", text, field=name, hint="correct it")
    return value_mm * MM


def _print_fit(report: FitReport, cut_file: CutFile, path: Path) -> None:
    """Print the fitted parameters, the residuals, and how to use the foam file at ``path``."""
    from planner.processes.hotwire.plan.kerf import models as kerf_models

    fit, residuals = report.fit, abs(report.residuals[report.kept]) / MM
    half_width = float(kerf_models.interval_half_width(fit, fit.mean_ideal)) / MM
    out.print(f"chi {fit.chi:.3f}, offset {fit.offset / MM:.3f} mm")
    out.print(
        f"{fit.count} cuts used; left out as too hot {report.hot.sum()}, as too cold {report.cold.sum()}"
    )
    out.print(f"residual: mean {residuals.mean():.3f} mm, largest {residuals.max():.3f} mm")
    out.print(
        f"9 of 10 cuts within {half_width:.2f} mm of the fit, in foam {cut_file.thickness / MM:g} mm thick"
    )
    out.print(f"written to {path}: tandem kerf width {path} --power-w ... --speed-mm-s ...")


@dataclasses.dataclass(frozen=True)
class Align:
    """Find the base of a cell's second robot from points that both robots probed, and write the cell.

    The CSV file has a row for each point: name, and for both arms <arm>.x_mm, <arm>.y_mm, <arm>.z_mm, the TCP
    in the robot's own base as the controller shows it. Nothing is written while a point does not fit.
    """

    cell: tyro.conf.Positional[Path]
    """the cell, YAML"""
    points: tyro.conf.Positional[Path]
    """the probed points, CSV"""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """the cell to write; its comments are kept"""
    arm: str | None = None
    """the arm whose base is searched; else the second of the cell"""
    tolerance_mm: float = 0.5
    """maximum distance of a point from the fit"""
    leave_out: tuple[str, ...] = ()
    """names of points to ignore"""


def run_align(request: Align) -> tuple[Issue, ...]:
    """Fit the base of an arm to points that both arms have probed, and write the cell with this base.

    The residuals and the change of the base are printed.

    Returns:
        Warnings if the points are nearly on a line.

    Raises:
        TandemError: ``align.*``, ``output.folder``, or the issues of an invalid cell file.
    """
    from planner.files import write_atomic
    from planner.geometry.arrays import inverse, to_rpy
    from planner.reading import strict_yaml
    from planner.reading.problem import read_cell
    from planner.shopfloor.align import probing, rigid_fit

    if not 0.0 < request.tolerance_mm <= 1000.0:
        message = f"tolerance: got {request.tolerance_mm:g} mm, allowed above 0, up to 1000 mm"
        raise issue_error("align.file", message, hint="correct it")
    document = strict_yaml.read(request.cell)
    cell = read_cell(document)
    index = probing.moved_arm(cell, request.arm, str(request.cell))
    fixed, moved = cell.arms[1 - index], cell.arms[index]
    arms = (fixed.name, moved.name)
    points = probing.read(request.points, arms)
    probing.require_reach(cell, (1 - index, index), points, str(request.points))
    used = probing.used_points(points, request.leave_out, str(request.points))
    alignment = rigid_fit.align(points.first, points.second, points.names, arms, used)
    issues = rigid_fit.tolerance_issues(
        alignment, points.first, points.second, points.names, request.tolerance_mm * MM
    )
    _print_points(alignment, points, {issue.target for issue in issues})
    if issues:
        raise TandemError([dataclasses.replace(issue, file=str(request.points)) for issue in issues])
    base = fixed.base @ alignment.pose
    text = probing.with_base(document, index, base)
    probing.require_readable(text, request.output, document)
    try:
        write_atomic(request.output, text)
    except (OSError, ValueError) as error:
        message = f"{request.output}: cannot be written ({getattr(error, 'strerror', None) or error})"
        raise issue_error("output.folder", message, hint="choose another path") from error
    xyz, rpy = probing.rounded(base)
    shift = inverse(moved.base) @ base
    out.print(f"base of {moved.name}: xyz_mm {xyz}, rpy_deg {rpy}")
    max_rotation = float(abs(to_rpy(shift[:3, :3])).max()) / DEG
    distance = float((shift[:3, 3] ** 2).sum() ** 0.5) / MM
    out.print(f"it moved by {distance:.1f} mm and up to {max_rotation:.3f} deg from the base in the cell")
    out.print(
        f"from {int(alignment.used.sum())} points: known to {alignment.position_sigma / MM:.2f} mm and "
        f"{alignment.turn_sigma / DEG:.3f} deg (one standard deviation, worst direction)"
    )
    out.print(f"written to {request.output}")
    return rigid_fit.collinearity_warnings(points.first[used], points.second[used], arms)


def _print_points(alignment: Alignment, points: ProbedPoints, bad_names: set[str | None]) -> None:
    """Print the residual of each probed point, and which points were left out or do not fit."""
    table = Table("point", "error mm", "x mm", "y mm", "z mm", "")
    for index, name in enumerate(points.names):
        remark = "left out" if not alignment.used[index] else "BAD" if name in bad_names else ""
        x, y, z = alignment.residual[index] / MM
        table.add_row(
            name, f"{alignment.distance[index] / MM:.3f}", f"{x:+.3f}", f"{y:+.3f}", f"{z:+.3f}", remark
        )
    out.print(table)


MIN_WALL_ANGLE_RAD = 0.5 * DEG
"""Angle [rad] to the sheet below which a face is not a wall."""


@dataclasses.dataclass(frozen=True)
class Features:
    """Show the features of a sheet part: what is formed down and up, on what, and from which level to which.

    The mesh is the part's open surface in the sheet's frame, z normal to the sheet.
    """

    part: tyro.conf.Positional[Path]
    """the part's surface: OBJ, STL or PLY; or a bundled problem's file"""
    unit: Literal["mm", "cm", "m", "in", "ft"] = "mm"
    """unit of the lengths in the mesh"""
    step_mm: float = 1.0
    """distance of the contours in z"""
    strategy: Literal["in_place", "virgin"] = "in_place"
    """forming order: parents first, or children first and each on the virgin sheet"""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """file to write: .html (contours, tree and table), .svg (contours) or .json (centres, depths, angles)"""
    tolerance_mm: float | None = None
    """maximum deviation of mesh vertices from the intended face; else determined from the mesh"""


def run_features(request: Features) -> tuple[Issue, ...]:
    """Print the features of a sheet part as a tree, and write the requested file. Return notes and warnings.

    Raises:
        TandemError: The mesh is not usable.
    """
    from planner.catalogue.robots import bundled_path
    from planner.geometry.arrays import Mesh
    from planner.geometry.mesh_files import read_mesh
    from planner.processes.forming import feature_page
    from planner.processes.forming.plan.features import tree as feature_tree
    from planner.processes.forming.plan.features.tree import MIN_BUMP_HEIGHT_M, build_feature_tree
    from planner.reading.sheet import recover_face

    require_suffix(request.output, "a drawing is .html or .svg, a table .json", (".html", ".svg", ".json"))
    path = bundled_path(request.part)
    stated_tolerance = None if request.tolerance_mm is None else request.tolerance_mm * MM
    face = recover_face(read_mesh(path, LENGTH_UNITS[request.unit]), stated_tolerance, path)
    mesh = Mesh(face.face.vertices, face.face.faces)
    tree = build_feature_tree(mesh, request.step_mm * MM, max(MIN_BUMP_HEIGHT_M, face.tolerance))
    order = feature_tree.in_place_order if request.strategy == "in_place" else feature_tree.virgin_sheet_order
    out.print(_feature_tree_view(tree, request.part.name))
    out.print(
        "forming order: "
        + ", ".join(
            f"{step.feature}" + (f" (moved by {step.shift / MM:+.2f} mm)" if step.shift else "")
            for step in order(tree)
        )
    )
    if request.output is not None:
        suffix = request.output.suffix.lower()
        if suffix == ".json":
            table = {
                "part": request.part.name,
                "tolerance_mm": _to_mm(face.tolerance),
                **_feature_table(tree, mesh),
            }
            table["order"] = [_order_row(step) for step in order(tree)]
            content = json.dumps(table, indent=2) + "\n"
        elif suffix == ".svg":
            content = feature_tree.standalone_drawing(tree)
        else:
            content = feature_page.drawing_page(tree, f"Features of {request.part.name}")
        write_output(request.output, content, "written to" if suffix == ".json" else "drawn in")
    return (*face.notes, *tree.issues)


def _feature_table(tree: FeatureTree, mesh: Mesh) -> dict[str, Any]:
    """Return the tree as data: lengths in mm in the frame of the mesh, angles in degrees to the sheet."""
    return {
        "level_mm": _to_mm(tree.level),
        "features": [_feature_row(tree, mesh, feature) for feature in tree.features],
    }


def _feature_row(tree: FeatureTree, mesh: Mesh, feature: Feature) -> dict[str, Any]:
    """Return one feature as data, with lengths in mm and angles in degrees.

    The mean wall angle is weighted by area. Faces flatter than `MIN_WALL_ANGLE_RAD` do not count.
    """
    import numpy as np
    from shapely import Polygon

    from planner.geometry.mesh import TriangleMesh, face_areas, face_normals
    from planner.processes.forming.plan.features.pass_shape import feature_face
    from planner.processes.forming.plan.sheet_mechanics import wall_angle

    face = feature_face(mesh, tree, feature.id, 0.0)
    triangles = TriangleMesh(face.vertices, face.faces)
    slope = np.arccos(np.clip(face_normals(triangles)[:, 2], -1.0, 1.0))
    area = np.where(slope > MIN_WALL_ANGLE_RAD, face_areas(triangles), 0.0)
    outline = Polygon(feature.region).buffer(0.0)
    last_contour = Polygon(feature.contours[-1][:, :2]).buffer(0.0)
    low_x, low_y, high_x, high_y = outline.bounds
    return {
        "id": feature.id,
        "kind": feature.kind,
        "parent": feature.parent,
        "children": list(feature.children),
        "start_mm": _to_mm(feature.start),
        "end_mm": _to_mm(feature.end),
        "depth_mm": _to_mm(abs(feature.end - feature.start)),
        "centre_mm": [_to_mm(outline.centroid.x), _to_mm(outline.centroid.y)],
        "end_centre_mm": None
        if last_contour.is_empty
        else [_to_mm(last_contour.centroid.x), _to_mm(last_contour.centroid.y)],
        "size_mm": [_to_mm(high_x - low_x), _to_mm(high_y - low_y)],
        "wall_angle_deg": round(wall_angle(face.vertices, face.faces) / DEG, 2),
        "mean_wall_angle_deg": round(float((slope * area).sum() / max(float(area.sum()), 1e-30)) / DEG, 2),
        "contours": len(feature.contours),
    }


def _order_row(step: OrderStep) -> dict[str, Any]:
    return {"feature": step.feature, "shift_mm": _to_mm(step.shift)}


def _to_mm(value: float) -> float:
    return round(float(value) / MM, 4) + 0.0  # the sum turns -0.0 into 0.0


def _feature_tree_view(tree: FeatureTree, name: str) -> Tree:
    """Return the features as a tree for the terminal. Parents precede their children in ``tree.features``."""
    count = len(tree.features)
    root = Tree(
        f"{escape(name)}: {count} feature{'s' if count > 1 else ''}, flat at z = {tree.level / MM:z.3f} mm"
    )
    nodes: dict[int, Tree] = {}
    for feature in tree.features:
        parent = root if feature.parent is None else nodes[feature.parent]
        nodes[feature.id] = parent.add(_feature_line(feature))
    return root


def _feature_line(feature: Feature) -> str:
    from planner.geometry.curves import bounding_sides

    direction = "down" if feature.sign < 0 else "up"
    long, short = (side / MM for side in bounding_sides(feature.region[:, :2]))
    return (
        f"{feature.id} {feature.kind} ({direction}) {feature.start / MM:z.2f} to {feature.end / MM:z.2f} mm, "
        f"{long:.1f} x {short:.1f} mm across, {len(feature.contours)} contours"
    )
