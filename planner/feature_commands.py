"""``tandem features PART``: the features of a sheet part, printed and drawn."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console
from rich.markup import escape
from rich.tree import Tree

from planner.issues import Issue, TandemError
from planner.units import LENGTH_UNITS, MM

if TYPE_CHECKING:
    from planner.forming.feature_tree import Feature, FeatureTree

out = Console(highlight=False, soft_wrap=True)
DRAWINGS = (".html", ".svg")


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
    """drawing to write, .html (contours, tree and table) or .svg (contours)"""


def run(request: Features) -> tuple[Issue, ...]:
    """Print the tree, write the drawing; warnings come back. Raises `TandemError` (rooms mesh, forming)."""
    from planner.catalogue import bundled
    from planner.files import write_whole
    from planner.forming import feature_drawing, feature_order
    from planner.forming.feature_tree import build
    from planner.geometry.mesh import read_mesh
    from planner.problem import Mesh

    if request.output is not None and request.output.suffix.lower() not in DRAWINGS:
        what = f"{request.output.name}: a drawing is .html or .svg; name it so"
        raise TandemError(Issue("output.folder", what, field="output"))
    read = read_mesh(bundled(request.part), LENGTH_UNITS[request.unit])
    tree = build(Mesh(read.vertices, read.faces), request.step_mm * MM)
    order = feature_order.in_place if request.strategy == "in_place" else feature_order.on_virgin_sheet
    out.print(_shown(tree, request.part.name))
    out.print(
        "order of forming: "
        + ", ".join(
            f"{step.feature}" + (f" (moved by {step.shift / MM:+.2f} mm)" if step.shift else "")
            for step in order(tree)
        )
    )
    if request.output is not None:
        drawn = feature_drawing.page(tree, f"Features of {request.part.name}")
        if request.output.suffix.lower() == ".svg":
            drawn = feature_drawing.alone(tree)
        try:
            write_whole(request.output, drawn)
        except OSError as error:
            what = f"{request.output}: cannot be written ({error.strerror}); choose another place"
            raise TandemError(Issue("output.folder", what, field="output")) from error
        out.print(f"drawn in {escape(str(request.output))}")
    return tree.issues


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
    from planner.geometry.outlines import sides

    way = "down" if feature.sign < 0 else "up"
    long, short = (side / MM for side in sides(feature.region[:, :2]))
    return (
        f"{feature.id} {feature.kind} ({way}) {feature.start / MM:z.2f} to {feature.end / MM:z.2f} mm, "
        f"{long:.1f} x {short:.1f} mm across, {len(feature.contours)} contours"
    )
