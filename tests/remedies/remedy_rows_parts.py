"""Rows of ``test_remedies_of_data``: parts and the files that they come from."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import ezdxf
import numpy as np
import trimesh

from planner.geometry.wing import naca_section
from tests.geometry.test_ruled_approximation import grid_mesh
from tests.reading.part_specs import SQUARE, WING, circle, guides, outline
from tests.refusals import HYPAR, POSES, change
from tests.remedies.advice import ReportedFigure, Word
from tests.remedies.remedy_rows import GONE, Row, load
from tests.rhino_files import Model
from tests.rhino_files import curve as rhino_curve

SHEET: Final = "v 0 0 0\nv 100 0 0\nv 0 100 0\nv 100 100 0\nf 1 2 3\nf 2 4 3\n"
AIRFOIL: Final = [f"{x:.6f} {y:.6f}" for x, y in naca_section("2412")]


def block(part: Any, size: list[float] | None = None) -> Any:
    """Return a problem with a part in a block of that size [mm]."""
    return {**change(POSES, "stock.size_mm", size or [300, 600, 100]), "part": part}


def mesh(code: str, text: str, says: str) -> Row:
    """A front whose file is exported again."""
    part = {"front": {"mesh": {"file": "m.obj", "unit": "mm"}}}
    return Row(code, load, block(part), says, {"@m.obj": SHEET}, {"m.obj": text})


def airfoil(code: str, rows: list[str], says: str) -> Row:
    """A section whose file is put right."""
    part = {"wing": {**WING, "root": {"file": "a.dat", "chord_mm": 200}}}
    lines = "\n".join(rows) + "\n"
    return Row(code, load, block(part), says, {"@a.dat": "\n".join(["x", *AIRFOIL]) + "\n"}, {"a.dat": lines})


def wave(rows: list[str]) -> list[str]:
    """A section that crosses itself: its middle is turned upside down."""
    pairs = [[float(v) for v in row.split()] for row in rows]
    return [f"{x:.6f} {-y if 0.4 < x < 0.7 else y:.6f}" for x, y in pairs]


def drawing(*open_by: float, closed: bool = True, unit: int = 4) -> str:
    """Return a DXF file of a square on layer cut, with an open gap of the given size [mm], and a text."""
    document = ezdxf.new("R2010")
    document.units = unit
    space = document.modelspace()
    gap = open_by[0] if open_by else 0.0
    for a, b in (((0, 0), (80, 0)), ((80, 0), (80, 80)), ((80, 80), (0, 80)), ((0, 80), (0, gap))):
        space.add_line(a, b, dxfattribs={"layer": "cut"})
    if not closed:
        space.add_text("a note", dxfattribs={"layer": "cut"})
    out = io.StringIO()
    document.write(out)
    return out.getvalue()


def model(hidden: bool = False) -> bytes:
    """Return a Rhino file of a square on layer cut and a hidden line."""
    made = Model()
    made.layer("cut")
    made.add(rhino_curve([(0, 0, 0), (80, 0, 0), (80, 80, 0), (0, 80, 0), (0, 0, 0)], 1), "cut")
    if hidden:
        made.add(rhino_curve([(0, 0, 0), (0, 200, 0)], 1), "cut", Visible=False)
    with tempfile.TemporaryDirectory() as folder:
        return made.write(Path(folder) / "plate.3dm").read_bytes()


def ply(
    height: Callable[[Any, Any], Any], cells: int, holes: tuple[int, ...] = (), is_flipped: bool = False
) -> bytes:
    """A mesh file of z = height(x, y) over 200 x 150 mm, some of its faces left out, or all turned round."""
    made = grid_mesh(height, cells)
    faces = np.delete(made.faces, list(holes), axis=0)[:, :: -1 if is_flipped else 1]
    return bytes(trimesh.Trimesh(1e3 * made.vertices, faces, process=False).export(file_type="ply"))


DOME: Final = ply(lambda x, y: 3.0 * x * (0.2 - x) + 3.0 * y * (0.15 - y), 12)
FLAT: Final = ply(lambda x, y: 0.0 * x, 12)
HOLED: Final = ply(lambda x, y: 0.0 * x, 12, (70, 70 + 144))
PLATE_RHINO: Final = {"plate": {"rhino": {"file": "plate.3dm", "layer": "cut"}}}
PLATE_DXF: Final = {"plate": {"dxf": {"file": "plate.dxf", "unit": "mm", "layer": "cut"}}}
LARGE: Final = [500, 500, 300]
PATCH: Final = {"file": "m.ply", "unit": "mm"}
ROOF: Final = {
    "name": "roof",
    "start": {"bezier_mm": [[0, 0, 0], [100, 0, 40], [200, 0, 0]]},
    "end": {"bezier_mm": [[200, 80, 0], [100, 80, 30], [0, 80, 0]]},
}
TIP_EDGE: Final = "the tip's trailing edge is 20 mm thick, the section is # mm"
SQUARES: Final = "v 0 0 {z}\nv 100 0 {z}\nv 0 100 {z}\nv 100 100 {z}\nf 1 2 3\nf 3 2 4\n"
BENEATH: Final = SQUARES.format(z=0).replace("1 2 3", "1 3 2").replace("3 2 4", "2 3 4")
CORNERS: Final = "v 0 0 0\nv 100 0 0\nv 0 100 0\nf 1 3 2\n"
TWO_FACES: Final = {name: {"mesh": {"file": f"{name}.obj", "unit": "mm"}} for name in ("front", "back")}

ROWS: Final = [
    mesh("mesh.unreadable", SHEET.replace("f 2 4 3", "f 2 4 9"), "export it again"),
    mesh("mesh.empty", "v 0 0 0\nv 1 0 0\n", "export the surface"),
    mesh("mesh.non_manifold",
        "v 0 0 0\nv 100 0 0\nv 0 100 0\nv 0 -100 0\nv 0 0 100\nf 1 2 3\nf 2 1 4\nf 1 2 5\n",
        "delete the extra ones"),
    mesh("mesh.orientation", SHEET.replace("f 2 4 3", "f 2 3 4"), "unify the normals"),
    mesh("mesh.closed", "v 0 0 0\nv 100 0 0\nv 0 100 0\nv 0 0 100\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n",
        "export only that face"),
    mesh("mesh.pieces", "v 0 0 0\nv 10 0 0\nv 0 10 0\nv 100 0 0\nv 110 0 0\nv 100 10 0\nf 1 2 3\nf 4 5 6\n",
        "join them or export one"),
    Row("mesh.unit", load, block({"front": {"mesh": {"file": str(HYPAR), "unit": "mm", "scale": 1e-4}}}), "",
        {"part.front.mesh.scale": 1.0}),
    Row("part.faces", load, block(TWO_FACES), "reverse the front (flip: true",
        {"part.front.mesh.flip": True}, {"front.obj": SQUARES.format(z=0),
        "back.obj": SQUARES.format(z=20)}),
    Row("part.edges", load, block(TWO_FACES), "make the numbers of corners equal", {"@back.obj": BENEATH},
        {"front.obj": SQUARES.format(z=20), "back.obj": CORNERS}),
    Row("part.naca", load, block({"wing": {**WING, "tip": {"naca": "0099", "chord_mm": 100}}}), "1 to 40 %",
        {"part.wing.tip.naca": "0040"}),
    Row("part.wing", load, block({"wing": {**WING, "trailing_edge_mm": 20}}), "allowed is half of that",
        {"part.wing.trailing_edge_mm": ReportedFigure(TIP_EDGE,
        0.1, down=True, times=0.5)}),
    airfoil("part.airfoil_format", ["x", *AIRFOIL[:5], "hello", *AIRFOIL[5:]], "remove or correct it"),
    airfoil("part.airfoil_open", ["x", *AIRFOIL[: len(AIRFOIL) // 2]], "give both"),
    airfoil("part.airfoil_order", ["x", *AIRFOIL[:10], *AIRFOIL[5:]], "sort the points"),
    airfoil("part.airfoil_points", ["x", *AIRFOIL[:: len(AIRFOIL) // 10]],
        "use another file of the same section"),
    airfoil("part.airfoil_crossing", ["x", *wave(AIRFOIL)], "correct the points there"),
    airfoil("part.airfoil_note", ["x", *AIRFOIL[:4], *AIRFOIL[3:]], "points that repeat the one before"),
    Row("part.guide", load, block(guides(start={"polyline_mm": [[0, 0, 0], [0, 0, 0], [5, 0, 0]]})),
        "at least 3 points", {"part.ruled.0.start": {"polyline_mm": [[*p, 0] for p in SQUARE]}}),
    Row("part.guide_turned", load, block({"ruled": [ROOF]}), "reverse its points",
        {"part.ruled.0.end.bezier_mm": ROOF["end"]["bezier_mm"][::-1]}),
    Row("part.outline_overlap", load, block(outline(circle(100, 50, 10))), "move or join them",
        {"part.plate.outlines.1.circle.centre_mm": [120, 50]}),
    Row("part.outline_duplicate", load, block(outline({"polyline_mm": SQUARE[2:] + SQUARE[:2]})),
        "remove one of them", {"part.plate.outlines.1": GONE}),
    Row("part.outline_open", load, block(PLATE_DXF), "close them", {"@plate.dxf": drawing()},
        {"plate.dxf": drawing(30.0)}),
    Row("part.dxf", load, block(change(PLATE_DXF, "plate.dxf.layer", "nothing")), "its layers are cut",
        {"part.plate.dxf.layer": Word("its layers are (\\w+)")}, {"plate.dxf": drawing()}),
    Row("part.dxf_left_out", load, block(PLATE_DXF), "left out TEXT", {"@plate.dxf": drawing()},
        {"plate.dxf": drawing(closed=False)}),
    Row("part.dxf_unit", load, block(PLATE_DXF), "write unit: cm, or save it with the right unit",
        {"@plate.dxf": drawing()}, {"plate.dxf": drawing(unit=5)}),
    Row("part.rhino", load, block(change(PLATE_RHINO, "plate.rhino.layer", "nothing")), "its layers are cut",
        {"part.plate.rhino.layer": Word("its layers are (\\w+)")}, {"plate.3dm": model()}),
    Row("part.rhino_left_out", load, block(PLATE_RHINO), "show hidden objects", {"@plate.3dm": model()},
        {"plate.3dm": model(hidden=True)}),
    Row("part.not_ruled", load, block({"mesh": PATCH}, LARGE), "cut it into ruled strips (part.strips)",
        {"part": {"strips": {"mesh": PATCH, "tolerance_mm": 5}}}, {"m.ply": DOME}),
    Row("part.patch", load, block({"mesh": PATCH}, LARGE), "close its holes", {"@m.ply": FLAT},
        {"m.ply": HOLED}),
    Row("part.strips", load, block({"strips": {"mesh": PATCH, "tolerance_mm": 2, "take": 99}}, LARGE), "",
        {"part.strips.take": 1}, {"m.ply": DOME}),
]  # fmt: skip
