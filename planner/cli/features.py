"""``tandem features PART``: the features of a sheet part, printed and drawn."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.markup import escape
from rich.tree import Tree

from planner.issues import Issue, TandemError
from planner.units import DEG, LENGTH_UNITS, MM

if TYPE_CHECKING:
    from planner.forming.features.tree import Feature, FeatureTree, OrderStep
    from planner.geometry.arrays import Mesh

out = Console(highlight=False, soft_wrap=True)
OUTPUT_SUFFIXES = (".html", ".svg", ".json")
"""Endings of files that drawings or the table are written to."""
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


def run(request: Features) -> tuple[Issue, ...]:
    """Print the tree, write what is asked for; notes and warnings come back. Raises `TandemError`."""
    from planner.catalogue.robots import bundled
    from planner.files import write_whole
    from planner.forming.features import tree as feature_tree
    from planner.forming.features.tree import LEAST_BUMP, build
    from planner.geometry.arrays import Mesh
    from planner.geometry.mesh import read_mesh
    from planner.reading.sheet import smooth_face

    if request.output is not None and request.output.suffix.lower() not in OUTPUT_SUFFIXES:
        what = f"{request.output.name}: a drawing is .html or .svg, a table .json; name it so"
        raise TandemError(Issue("output.folder", what, field="output"))
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
            drawn = feature_tree.drawing_page(tree, f"Features of {request.part.name}")
        try:
            write_whole(request.output, drawn)
        except OSError as error:
            what = f"{request.output}: cannot be written ({error.strerror}); choose another place"
            raise TandemError(Issue("output.folder", what, field="output")) from error
        out.print(f"{'written to' if kind == '.json' else 'drawn in'} {escape(str(request.output))}")
    return (*face.notes, *tree.issues)


def _table(tree: FeatureTree, mesh: Mesh) -> dict[str, Any]:
    """The tree as data: lengths in mm, angles in degrees from the sheet plane, in the mesh's frame."""
    return {"level_mm": _mm(tree.level), "features": [_row(tree, mesh, one) for one in tree.features]}


def _row(tree: FeatureTree, mesh: Mesh, feature: Feature) -> dict[str, Any]:
    """One feature: the middle of its outline and of its last contour, its depth, and the angle of its wall,
    the steepest and in the mean over the wall's area."""
    import numpy as np
    from shapely import Polygon

    from planner.forming.features.pass_shape import alone
    from planner.forming.sheet_mechanics import steepest
    from planner.geometry.mesh import TriangleMesh, face_areas, face_normals

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
