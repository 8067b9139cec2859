"""``tandem kerf``, ``align`` and ``features``: what is to be known before a problem can be written.

``tandem kerf fit | width | speed | power``: a foam of one's own from test cuts, and its kerfs.
``tandem align``: where the second robot of a cell stands, from points that both robots probed.
``tandem features PART``: the features of a sheet part, printed and drawn.
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
from planner.issues import Issue, TandemError, refusal

if TYPE_CHECKING:
    from planner.catalogue.materials import Foam
    from planner.geometry.arrays import Mesh
    from planner.processes.forming.plan.features.tree import Feature, FeatureTree, OrderStep
    from planner.processes.hotwire.plan.kerf.calibration import CutFile, FitReport
    from planner.processes.hotwire.plan.kerf.width import KerfEstimate
    from planner.shopfloor.align.probing import ProbedPoints
    from planner.shopfloor.align.rigid_fit import Alignment


@dataclasses.dataclass(frozen=True)
class Fit:
    """Fit a foam of your own from test cuts, and write a foam file that problems may name.

    The CSV file has columns power_w, speed_mm_s, and either kerf_mm or measured_side_mm with
    nominal_side_mm; also wire_length_mm, thickness_mm, and face (ok, burnt, dragging) where you have them.
    Cuts of no stated face are left out where the fit gives them a kerf outside 0.8 to 3 mm.
    """

    tests: tyro.conf.Positional[Path]
    """the file of test cuts, CSV"""
    density_kg_m3: float
    """density of the foam: weigh a block"""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("my_foam.yaml")
    """the foam file to write"""
    name: str = "my_foam"
    """name of the foam: a letter first, then letters, digits and underscores"""
    thickness_mm: float | None = None
    """thickness of the foam in the tests, unless the file has it"""
    wire_length_mm: float | None = None
    """heated length of the wire, unless the file has it"""
    wire_diameter_mm: float = 0.4
    """diameter of the wire"""
    specific_heat_j_kg_k: float = 1450.0
    """chi makes up for an error in it"""
    melt_temperature_c: float = 280.0
    """chi makes up for an error in it"""
    conductivity_w_m_k: float | None = None
    """kept in the foam file; the fit has no use for it"""


@dataclasses.dataclass(frozen=True)
class _Question:
    foam: tyro.conf.Positional[str]
    """a built-in foam, or a foam file"""
    thickness_mm: float = 50.0
    """thickness of the foam along the wire"""
    wire_length_mm: float = 430.0
    """heated length of the wire, over which its power is spread"""
    wire_diameter_mm: float = 0.4
    """diameter of the wire"""
    model: Literal["energy", "general", "measured", "dissertation"] = "energy"
    """which model answers"""


@dataclasses.dataclass(frozen=True)
class Width(_Question):
    """Kerf at a power and a speed."""

    power_w: float = tyro.MISSING
    """power of the whole heated wire"""
    speed_mm_s: float = tyro.MISSING
    """speed of the wire across itself"""


@dataclasses.dataclass(frozen=True)
class Speed(_Question):
    """Speed for a wanted kerf at a power."""

    power_w: float = tyro.MISSING
    """power of the whole heated wire"""
    kerf_mm: float = tyro.MISSING
    """wanted width of the slot"""


@dataclasses.dataclass(frozen=True)
class Power(_Question):
    """Power for a wanted kerf at a speed."""

    speed_mm_s: float = tyro.MISSING
    """speed of the wire across itself"""
    kerf_mm: float = tyro.MISSING
    """wanted width of the slot"""


Action = tyro.conf.OmitSubcommandPrefixes[
    Annotated[Fit, tyro.conf.subcommand("fit")]
    | Annotated[Width, tyro.conf.subcommand("width")]
    | Annotated[Speed, tyro.conf.subcommand("speed")]
    | Annotated[Power, tyro.conf.subcommand("power")]
]


def run_kerf(action: Fit | Width | Speed | Power) -> None:
    """Answer, or fit and write. Raises `TandemError` with codes in the room ``kerf``."""
    if isinstance(action, Fit):
        _fit(action)
    else:
        _width_at(action)


def _width_at(question: Width | Speed | Power) -> None:
    from planner.processes.hotwire.plan.kerf import width as kerf

    foam = _foam(question.foam)
    wire = kerf.HotWire(question.wire_diameter_mm * MM, question.wire_length_mm * MM)
    thickness = question.thickness_mm * MM
    if isinstance(question, Speed):
        power, kerf_width = question.power_w, question.kerf_mm * MM
        speed = float(kerf.speed_for(foam, wire, power, kerf_width, thickness, question.model))
    elif isinstance(question, Power):
        speed, kerf_width = question.speed_mm_s * MM, question.kerf_mm * MM
        power = float(kerf.power_for(foam, wire, speed, kerf_width, thickness, question.model))
    else:
        power, speed = question.power_w, question.speed_mm_s * MM
    _print(kerf.width(foam, wire, power, speed, thickness, question.model), power, speed)


def _print(estimate: KerfEstimate, power: float, speed: float) -> None:
    from planner.processes.hotwire.plan.kerf.width import explain

    low, middle, high = (float(value) / MM for value in (estimate.low, estimate.width, estimate.high))
    out.print(f"kerf {middle:.2f} mm ({low:.2f} to {high:.2f} mm in 9 of 10 cuts)")
    out.print(f"at {power:.1f} W and {speed / MM:.2f} mm/s")
    for text in explain(int(estimate.flag)):
        out.print(f"mind: {text}")


def _foam(text: str) -> Foam:
    from planner.catalogue.materials import foam
    from planner.reading import materials as material_file

    return material_file.read_foam(Path(text)) if text.endswith((".yaml", ".yml")) else foam(text)


def _fit(request: Fit) -> None:
    from planner.processes.hotwire.plan.kerf import calibration
    from planner.reading import materials as material_file

    given: dict[str, object] = {
        "density_kg_m3": request.density_kg_m3,
        "specific_heat_j_kg_k": request.specific_heat_j_kg_k,
        "melt_temperature_c": request.melt_temperature_c,
        "name": request.name,
    }
    if request.conductivity_w_m_k is not None:
        given["conductivity_w_m_k"] = request.conductivity_w_m_k
    foam = material_file.make_foam(given)
    diameter = _metres("wire_diameter_mm", request.wire_diameter_mm)
    length = None if request.wire_length_mm is None else _metres("wire_length_mm", request.wire_length_mm)
    thickness = None if request.thickness_mm is None else _metres("thickness_mm", request.thickness_mm)
    read = calibration.read_cuts(request.tests, diameter, length, thickness)
    report = calibration.robust(
        foam, read.cuts, read.burnt, read.dragging, read.good, read.thickness, diameter
    )
    today = dt.date.today().isoformat()
    source = f"{report.fit.count} of {len(read.cuts)} test cuts in {request.tests.name}, fitted {today}"
    material_file.write_foam(request.output, dataclasses.replace(foam, kerf=report.fit), source)
    _print_fit(report, read, request.output)


def _metres(name: str, value_mm: float) -> float:
    if not (math.isfinite(value_mm) and value_mm > 0.0):
        text = f"got {value_mm:g}, allowed a number above 0"
        raise refusal("kerf.input", text, field=name, hint="correct it")
    return value_mm * MM


def _print_fit(report: FitReport, read: CutFile, path: Path) -> None:
    from planner.processes.hotwire.plan.kerf import models as kerf_models

    fit, size = report.fit, abs(report.residuals[report.kept]) / MM
    half = float(kerf_models.margin(fit, fit.mean_ideal)) / MM
    out.print(f"chi {fit.chi:.3f}, offset {fit.offset / MM:.3f} mm")
    out.print(
        f"{fit.count} cuts used; left out as too hot {report.hot.sum()}, as too cold {report.cold.sum()}"
    )
    out.print(f"residual {size.mean():.3f} mm in the mean, {size.max():.3f} mm at worst")
    out.print(f"9 of 10 cuts within {half:.2f} mm of the fit, in foam {read.thickness / MM:g} mm thick")
    out.print(f"written to {path}: tandem kerf width {path} --power-w ... --speed-mm-s ...")


@dataclasses.dataclass(frozen=True)
class Align:
    """Find the base of a cell's second robot from points that both robots probed, and write the cell anew.

    The CSV file has a row for each point: name, and for both arms <arm>.x_mm, <arm>.y_mm, <arm>.z_mm, where
    the controller shows the TCP in the robot's own base. Nothing is written while a point does not fit.
    """

    cell: tyro.conf.Positional[Path]
    """the cell, YAML"""
    points: tyro.conf.Positional[Path]
    """the probed points, CSV"""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """the cell to write; its comments stay"""
    arm: str | None = None
    """the arm whose base is looked for; else the second of the cell"""
    tolerance_mm: float = 0.5
    """how far a point may be from the fit"""
    leave_out: tuple[str, ...] = ()
    """names of points that are not to count"""


def run_align(request: Align) -> tuple[Issue, ...]:
    """Fit, print, and write the cell; warnings come back. Raises `TandemError` (room align, and what a cell's
    file can have)."""
    from planner.files import write_whole
    from planner.geometry.arrays import inverse, to_rpy
    from planner.reading import strict_yaml
    from planner.reading.problem import read_cell
    from planner.shopfloor.align import probing, rigid_fit

    if not 0.0 < request.tolerance_mm <= 1000.0:
        what = f"tolerance: got {request.tolerance_mm:g} mm, allowed above 0, up to 1000 mm"
        raise refusal("align.file", what, hint="correct it")
    document = strict_yaml.read(request.cell)
    cell = read_cell(document)
    index = probing.moved_arm(cell, request.arm, str(request.cell))
    fixed, moved = cell.arms[1 - index], cell.arms[index]
    arms = (fixed.name, moved.name)
    points = probing.read(request.points, arms)
    probing.require_reach(cell, (1 - index, index), points, str(request.points))
    used = probing.used_points(points, request.leave_out, str(request.points))
    found = rigid_fit.align(points.first, points.second, points.names, arms, used)
    issues = rigid_fit.tolerance_issues(
        found, points.first, points.second, points.names, request.tolerance_mm * MM
    )
    _print_points(found, points, {issue.target for issue in issues})
    if issues:
        raise TandemError([dataclasses.replace(i, file=str(request.points)) for i in issues])
    base = fixed.base @ found.pose
    text = probing.with_base(document, index, base)
    probing.require_readable(text, request.output, document)
    try:
        write_whole(request.output, text)
    except (OSError, ValueError) as error:
        what = f"{request.output}: cannot be written ({getattr(error, 'strerror', None) or error})"
        raise refusal("output.folder", what, hint="choose a place of your own") from error
    xyz, rpy = probing.rounded(base)
    shift = inverse(moved.base) @ base
    out.print(f"base of {moved.name}: xyz_mm {xyz}, rpy_deg {rpy}")
    turned = float(abs(to_rpy(shift[:3, :3])).max()) / DEG
    was = float((shift[:3, 3] ** 2).sum() ** 0.5) / MM
    out.print(f"before, the cell had it {was:.1f} mm and up to {turned:.3f} deg elsewhere")
    out.print(
        f"from {int(found.used.sum())} points: known to {found.position_sigma / MM:.2f} mm and "
        f"{found.turn_sigma / DEG:.3f} deg (one standard deviation, worst direction)"
    )
    out.print(f"written to {request.output}")
    return rigid_fit.collinearity_warnings(points.first[used], points.second[used], arms)


def _print_points(found: Alignment, points: ProbedPoints, bad: set[str | None]) -> None:
    table = Table("point", "off mm", "x mm", "y mm", "z mm", "")
    for k, name in enumerate(points.names):
        remark = "left out" if not found.used[k] else "BAD" if name in bad else ""
        x, y, z = found.residual[k] / MM
        table.add_row(name, f"{found.distance[k] / MM:.3f}", f"{x:+.3f}", f"{y:+.3f}", f"{z:+.3f}", remark)
    out.print(table)


LEVEL_ANGLE = 0.5 * DEG
"""What leans less is no wall."""


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
    """order of forming: parents first, or children first and each on the virgin sheet"""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """what to write: .html (contours, tree and table), .svg (contours) or .json (centres, depths, angles)"""
    tolerance_mm: float | None = None
    """how far the mesh's vertices may be off the face that is meant; found from the mesh unless stated"""


def run_features(request: Features) -> tuple[Issue, ...]:
    """Print the tree, write what is asked for; notes and warnings come back. Raises `TandemError`."""
    from planner.catalogue.robots import bundled
    from planner.geometry.arrays import Mesh
    from planner.geometry.mesh_files import read_mesh
    from planner.processes.forming import feature_page
    from planner.processes.forming.plan.features import tree as feature_tree
    from planner.processes.forming.plan.features.tree import LEAST_BUMP, build
    from planner.reading.sheet import smooth_face

    require_suffix(request.output, "a drawing is .html or .svg, a table .json", (".html", ".svg", ".json"))
    path = bundled(request.part)
    stated = None if request.tolerance_mm is None else request.tolerance_mm * MM
    face = smooth_face(read_mesh(path, LENGTH_UNITS[request.unit]), stated, path)
    mesh = Mesh(face.meant.vertices, face.meant.faces)
    tree = build(mesh, request.step_mm * MM, max(LEAST_BUMP, face.tolerance))
    order = feature_tree.in_place if request.strategy == "in_place" else feature_tree.on_virgin_sheet
    out.print(_shown(tree, request.part.name))
    out.print(
        "order of forming: "
        + ", ".join(
            f"{step.feature}" + (f" (moved by {step.shift / MM:+.2f} mm)" if step.shift else "")
            for step in order(tree)
        )
    )
    if request.output is not None:
        kind = request.output.suffix.lower()
        if kind == ".json":
            table = {"part": request.part.name, "tolerance_mm": _mm(face.tolerance), **_table(tree, mesh)}
            table["order"] = [_moved(step) for step in order(tree)]
            drawn = json.dumps(table, indent=2) + "\n"
        elif kind == ".svg":
            drawn = feature_tree.alone(tree)
        else:
            drawn = feature_page.drawing_page(tree, f"Features of {request.part.name}")
        write_output(request.output, drawn, "written to" if kind == ".json" else "drawn in")
    return (*face.notes, *tree.issues)


def _table(tree: FeatureTree, mesh: Mesh) -> dict[str, Any]:
    """The tree as data: lengths in mm, angles in degrees from the sheet plane, in the mesh's frame."""
    return {"level_mm": _mm(tree.level), "features": [_row(tree, mesh, one) for one in tree.features]}


def _row(tree: FeatureTree, mesh: Mesh, feature: Feature) -> dict[str, Any]:
    """One feature: the middle of its outline and of its last contour, its depth, and the angle of its wall,
    the steepest and in the mean over the wall's area."""
    import numpy as np
    from shapely import Polygon

    from planner.geometry.mesh import TriangleMesh, face_areas, face_normals
    from planner.processes.forming.plan.features.pass_shape import alone
    from planner.processes.forming.plan.sheet_mechanics import steepest

    face = alone(mesh, tree, feature.id, 0.0)
    triangles = TriangleMesh(face.vertices, face.faces)
    lean = np.arccos(np.clip(face_normals(triangles)[:, 2], -1.0, 1.0))
    area = np.where(lean > LEVEL_ANGLE, face_areas(triangles), 0.0)
    outline = Polygon(feature.region).buffer(0.0)
    last = Polygon(feature.contours[-1][:, :2]).buffer(0.0)
    low_x, low_y, high_x, high_y = outline.bounds
    return {
        "id": feature.id,
        "kind": feature.kind,
        "parent": feature.parent,
        "children": list(feature.children),
        "start_mm": _mm(feature.start),
        "end_mm": _mm(feature.end),
        "depth_mm": _mm(abs(feature.end - feature.start)),
        "centre_mm": [_mm(outline.centroid.x), _mm(outline.centroid.y)],
        "end_centre_mm": None if last.is_empty else [_mm(last.centroid.x), _mm(last.centroid.y)],
        "size_mm": [_mm(high_x - low_x), _mm(high_y - low_y)],
        "wall_angle_deg": round(steepest(face.vertices, face.faces) / DEG, 2),
        "mean_wall_angle_deg": round(float((lean * area).sum() / max(float(area.sum()), 1e-30)) / DEG, 2),
        "contours": len(feature.contours),
    }


def _moved(step: OrderStep) -> dict[str, Any]:
    return {"feature": step.feature, "shift_mm": _mm(step.shift)}


def _mm(value: float) -> float:
    return round(float(value) / MM, 4) + 0.0


def _shown(tree: FeatureTree, name: str) -> Tree:
    count = len(tree.features)
    shown = Tree(
        f"{escape(name)}: {count} feature{'s' if count > 1 else ''}, flat at z = {tree.level / MM:z.3f} mm"
    )
    nodes: dict[int, Tree] = {}
    for feature in tree.features:
        above = shown if feature.parent is None else nodes[feature.parent]
        nodes[feature.id] = above.add(_line(feature))
    return shown


def _line(feature: Feature) -> str:
    from planner.geometry.curves import sides

    way = "down" if feature.sign < 0 else "up"
    long, short = (side / MM for side in sides(feature.region[:, :2]))
    return (
        f"{feature.id} {feature.kind} ({way}) {feature.start / MM:z.2f} to {feature.end / MM:z.2f} mm, "
        f"{long:.1f} x {short:.1f} mm across, {len(feature.contours)} contours"
    )
