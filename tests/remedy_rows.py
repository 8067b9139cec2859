"""Rows of ``test_remedies_of_data``: bad data of every room, and what its issue advises to do to it."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import ezdxf
import numpy as np
import trimesh
import yaml

from planner import align_commands, pipeline, processes
from planner.batch.batch_file import read_batch
from planner.geometry.airfoil import naca
from planner.hotwire import kerf, kerf_csv, kerf_fit, wire
from planner.issues import Issue, TandemError
from planner.materials import foam
from planner.post import write as post
from planner.problem import Controller
from tests import small_forming, small_problem, test_gripping
from tests.geometry.part_specs import SQUARE, WING, circle, guides, outline
from tests.geometry.test_surfaces import grid_mesh
from tests.refusals import HYPAR, POSES, change
from tests.test_remedies import Said, Word
from tests.test_setups import CELL as BOW_AND_GRIPPER

GONE: Final = object()
"""In a remedy: the field is taken out."""
How = Callable[[Path, Any], list[Issue]]


@dataclasses.dataclass(frozen=True)
class Row:
    """One fault: ``how`` finds the issues of ``data`` in a folder with ``files``; ``says`` stands in the
    issue of that ``code``, and ``remedy`` does so: fields of the data, or files by ``@name``."""

    code: str
    how: How
    data: Any
    says: str
    remedy: Mapping[str, Any]
    files: Mapping[str, str | bytes] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Yaml(Word):
    """A value that is taken from an issue as it would stand in the file, by a pattern with one group."""

    def of(self, issues: Sequence[Issue], now: Any) -> Any:
        return yaml.safe_load(super().of(issues, now))


def found(work: Callable[[], Iterable[Issue]]) -> list[Issue]:
    """What some work tells, or the issues of its refusal."""
    try:
        return list(work())
    except TandemError as error:
        return list(error.issues)


def write(folder: Path, data: Any) -> Path:
    path = folder / "p.yaml"
    path.write_text(data if isinstance(data, str) else yaml.safe_dump(data, allow_unicode=True), "utf-8")
    return path


def load(folder: Path, data: Any) -> list[Issue]:
    """Faults and notes of a problem that is loaded."""
    return found(lambda: pipeline._notes(pipeline.load(write(folder, data))))


def check(folder: Path, data: Any) -> list[Issue]:
    """What ``tandem check`` finds."""
    return found(lambda: pipeline.check(pipeline.load(write(folder, data))))


def lay(folder: Path, data: Any) -> list[Issue]:
    """What loading and the targets of all operations find: a check without the motion."""

    def work() -> Iterable[Issue]:
        problem = pipeline.load(write(folder, data))
        targets = pipeline._targets(problem, processes.jobs(problem))
        told = [
            *pipeline._notes(problem),
            *pipeline._stands(problem),
            *(i for t in targets for i in t.issues),
        ]
        return [*told, *post.refusals(problem, targets)]

    return found(work)


# ---- problems ----------------------------------------

HUNG = change(POSES, "stock.place", {"xyz_mm": [450, 0, 100]})
"""The small problem with its block in the air."""
TABLE: Final = "\n".join([small_problem.COLUMNS, *small_problem.ROWS]) + "\n"
ON_TABLE: Final = {**POSES, "stock": {**POSES["stock"], "support": "pedestal"}}
OBSTACLE: Final = {
    "name": "pole",
    "shapes": [{"kind": "sphere", "radius_mm": 30, "pose": {"xyz_mm": [2000, 2000, 100]}}],
}
HELD: Final = {
    **POSES,
    "cell": BOW_AND_GRIPPER,
    "stock": {"size_mm": [300, 200, 100], "foam": "eps_a120", "held_by": "right"},
}
FOAM_FILE: Final = "tandem_foam: 1\nname: mine\nspecific_heat_j_kg_k: 1400\nmelt_temperature_c: 240\n"
FREE: Final = {"name": "spin", "arms": ["left"], "axis": "z", "turn_deg": [-10, 10]}

PROBLEMS: Final = [
    Row("problem.missing_file", load, {**POSES, "cell": "cels.yaml"}, "check the path",
        {"cell": "cell.yaml"}, {"cell.yaml": yaml.safe_dump(POSES["cell"])}),
    Row("problem.not_yaml", load, small_problem.PROBLEM.replace("  arms:", "\tarms:", 1),
        "indent with spaces", {"": small_problem.PROBLEM}),
    Row("problem.field", load, change(POSES, "settings.sped_fraction", 0.5), "remove it",
        {"settings.sped_fraction": GONE}),
    Row("problem.duplicate_name", load, {**POSES, "operations": [*POSES["operations"],
        dict(POSES["operations"][0])]}, "rename one", {"operations.1.name": "other"}),
    Row("problem.unknown_robot", load, change(POSES, "cell.arms.0.robot", "irb9000"),
        "choose one of these names", {"cell.arms.0.robot": Word("catalogue, which has (\\w+)")}),
    Row("problem.unknown_arm", load, change(POSES, "operations.0.arms", ["middle"]), "the cell; it has left",
        {"operations.0.arms.0": Word("the cell; it has (\\w+)")}),
    Row("problem.unknown_process", load, change(POSES, "operations.0.process", "target"),
        "choose one of them", {"operations.0.process": Word("known are .*?(target\\w+)")}),
    Row("problem.not_finite", load, change(POSES, "stock.size_mm.1", float("inf")), "give a finite number",
        {"stock.size_mm.1": 100.0}),
    Row("problem.accepted", check, {**ON_TABLE, "accept": ["straight.drop"]}, "take it out",
        {"accept": GONE}),
    Row("problem.too_large", load, {**POSES, "part": {"wing": {**WING, "root": {"file": "a.dat",
        "chord_mm": 200}}}}, "", {"@a.dat": "", "part": GONE}, {"a.dat": "0.5 0.5\n" * 300_000}),
    Row("stock.gripper", load, change(HELD, "stock.held_by", "left"), "give it a gripper_plate",
        {"cell.arms.0.tool": {"kind": Word("give it a (\\w+)")}}),
    Row("stock.foam_missing", load, change(HELD, "stock.foam", None), "name its foam",
        {"stock.foam": "eps_a120"}),
    Row("stock.grip_force", load, change(HELD, "cell.arms.1.tool", {"kind": "vacuum_cup", "holding_n": 3.8}),
        "mount it", {"cell.arms.1.tool": {"kind": "gripper_plate", "width_mm": Said("width_mm: #"),
        "depth_mm": Said("depth_mm: #")}}),
    Row("stock.grip_chosen", load, test_gripping.data(test_gripping.WEDGE, test_gripping.LIST), "state it",
        {"stock.gripper": Word("state it: {gripper: (\\w+)"),
        "stock.grip": Yaml("grip: ({xyz_mm: .*?\\})")}),
    Row("problem.field", load, change(POSES, "cell.wires", []), "take the key out", {"cell.wires": GONE}),
    Row("stock.support", check, change(HUNG, "stock.support", [{"kind": "box", "size_mm": [50, 50, 50],
        "pose": {"xyz_mm": [0, 0, -25]}}]), "support: pedestal",
        {"stock.support": Word("support: (pedestal)")}),
    Row("stock.hangs", check, HUNG, "support: pedestal", {"stock.support": Word("support: (pedestal)")}),
    Row("cell.body_name", check, change(ON_TABLE, "cell.obstacles", [{**OBSTACLE, "name": "stock"}]), "",
        {"cell.obstacles.0.name": "pole"}),
    Row("targets.file", lay, POSES, "correct it", {"@targets.csv": TABLE},
        {"targets.csv": TABLE.replace("500,", "abc,", 1)}),
    Row("targets.held", lay, HELD, "leave stock.held_by out", {"stock.held_by": GONE,
        "stock.support": Word("support: (pedestal)")}),
    Row("targets.freedom", lay, change(POSES, "operations.0.free", [{**FREE, "slide_mm": [0, 1]}]),
        "one of them", {"operations.0.free.0.slide_mm": GONE}),
    Row("kerf.unknown_foam", load, change(HELD, "stock.foam", "granite"), "a foam that is built in",
        {"stock.foam": Word("got 'granite', allowed \\w+, (\\w+)")}),
    Row("kerf.foam_file", load, change(HELD, "stock.foam", {"file": "mine.yaml"}), "add it",
        {"@mine.yaml": FOAM_FILE + "density_kg_m3: 17\n"}, {"mine.yaml": FOAM_FILE}),
]  # fmt: skip


# ---- parts ----------------------------------------

SHEET: Final = "v 0 0 0\nv 100 0 0\nv 0 100 0\nv 100 100 0\nf 1 2 3\nf 2 4 3\n"
AIRFOIL: Final = [f"{x:.6f} {y:.6f}" for x, y in naca("2412")]


def block(part: Any, size: list[float] | None = None) -> Any:
    """A problem with a part in a block of that size [mm]."""
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


def drawing(*open_by: float, closed: bool = True) -> str:
    """A DXF file of a square on layer cut, a gap of that many mm left open, and a text."""
    document = ezdxf.new("R2010")
    space = document.modelspace()
    gap = open_by[0] if open_by else 0.0
    for a, b in (((0, 0), (80, 0)), ((80, 0), (80, 80)), ((80, 80), (0, 80)), ((0, 80), (0, gap))):
        space.add_line(a, b, dxfattribs={"layer": "cut"})
    if not closed:
        space.add_text("a note", dxfattribs={"layer": "cut"})
    out = io.StringIO()
    document.write(out)
    return out.getvalue()


def ply(height: Callable[[Any, Any], Any], cells: int, holes: tuple[int, ...] = ()) -> bytes:
    """A mesh file of z = height(x, y) over 200 x 150 mm, some of its faces left out."""
    made = grid_mesh(height, cells)
    faces = np.delete(made.faces, list(holes), axis=0)
    return bytes(trimesh.Trimesh(1e3 * made.vertices, faces, process=False).export(file_type="ply"))


DOME: Final = ply(lambda x, y: 3.0 * x * (0.2 - x) + 3.0 * y * (0.15 - y), 12)
FLAT: Final = ply(lambda x, y: 0.0 * x, 12)
HOLED: Final = ply(lambda x, y: 0.0 * x, 12, (70, 70 + 144))
PLATE_DXF: Final = {"plate": {"dxf": {"file": "plate.dxf", "unit": "mm", "layer": "cut"}}}
LARGE: Final = [500, 500, 300]
PATCH: Final = {"file": "m.ply", "unit": "mm"}
ROOF: Final = {
    "name": "roof",
    "start": {"bezier_mm": [[0, 0, 0], [100, 0, 40], [200, 0, 0]]},
    "end": {"bezier_mm": [[200, 80, 0], [100, 80, 30], [0, 80, 0]]},
}
TIP_EDGE: Final = "the tip's trailing edge is to be 20 mm thick, the section is # mm"
SQUARES: Final = "v 0 0 {z}\nv 100 0 {z}\nv 0 100 {z}\nv 100 100 {z}\nf 1 2 3\nf 3 2 4\n"
TWO_FACES: Final = {name: {"mesh": {"file": f"{name}.obj", "unit": "mm"}} for name in ("front", "back")}

PARTS: Final = [
    mesh("mesh.unreadable", SHEET.replace("f 2 4 3", "f 2 4 9"), "export it again"),
    mesh("mesh.empty", "v 0 0 0\nv 1 0 0\n", "export the surface"),
    mesh("mesh.non_manifold",
        "v 0 0 0\nv 100 0 0\nv 0 100 0\nv 0 -100 0\nv 0 0 100\nf 1 2 3\nf 2 1 4\nf 1 2 5\n",
        "delete the extra ones"),
    mesh("mesh.orientation", SHEET.replace("f 2 4 3", "f 2 3 4"), "unify the normals"),
    mesh("mesh.closed", "v 0 0 0\nv 100 0 0\nv 0 100 0\nv 0 0 100\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n",
        "export that face alone"),
    mesh("mesh.pieces", "v 0 0 0\nv 10 0 0\nv 0 10 0\nv 100 0 0\nv 110 0 0\nv 100 10 0\nf 1 2 3\nf 4 5 6\n",
        "join them or export one"),
    Row("mesh.unit", load, block({"front": {"mesh": {"file": str(HYPAR), "unit": "mm", "scale": 1e-4}}}), "",
        {"part.front.mesh.scale": 1.0}),
    Row("part.faces", load, block(TWO_FACES), "turn over the front (flip: true",
        {"part.front.mesh.flip": True}, {"front.obj": SQUARES.format(z=0),
        "back.obj": SQUARES.format(z=20)}),
    Row("part.naca", load, block({"wing": {**WING, "tip": {"naca": "0099", "chord_mm": 100}}}), "1 to 40 %",
        {"part.wing.tip.naca": "0040"}),
    Row("part.wing", load, block({"wing": {**WING, "trailing_edge_mm": 20}}), "half of that is allowed",
        {"part.wing.trailing_edge_mm": Said(TIP_EDGE,
        0.1, down=True, times=0.5)}),
    airfoil("part.airfoil_format", ["x", *AIRFOIL[:5], "hello", *AIRFOIL[5:]], "remove or correct it"),
    airfoil("part.airfoil_open", ["x", *AIRFOIL[: len(AIRFOIL) // 2]], "give both"),
    airfoil("part.airfoil_order", ["x", *AIRFOIL[:10], *AIRFOIL[5:]], "sort the points"),
    airfoil("part.airfoil_points", ["x", *AIRFOIL[:: len(AIRFOIL) // 10]],
        "take another file of the same section"),
    airfoil("part.airfoil_crossing", ["x", *wave(AIRFOIL)], "correct the points there"),
    airfoil("part.airfoil_note", ["x", *AIRFOIL[:4], *AIRFOIL[3:]], "points that repeat the one before"),
    Row("part.guide", load, block(guides(start={"polyline_mm": [[0, 0, 0], [0, 0, 0], [5, 0, 0]]})),
        "at least 3 points", {"part.ruled.0.start": {"polyline_mm": [[*p, 0] for p in SQUARE]}}),
    Row("part.guide_turned", load, block({"ruled": [ROOF]}), "turn its points around",
        {"part.ruled.0.end.bezier_mm": ROOF["end"]["bezier_mm"][::-1]}),
    Row("part.outline_overlap", load, block(outline(circle(100, 50, 10))), "move or join them",
        {"part.plate.outlines.1.circle.centre_mm": [120, 50]}),
    Row("part.outline_duplicate", load, block(outline({"polyline_mm": SQUARE[2:] + SQUARE[:2]})),
        "leave one out", {"part.plate.outlines.1": GONE}),
    Row("part.outline_open", load, block(PLATE_DXF), "close them", {"@plate.dxf": drawing()},
        {"plate.dxf": drawing(30.0)}),
    Row("part.dxf", load, block(change(PLATE_DXF, "plate.dxf.layer", "nothing")), "its layers are cut",
        {"part.plate.dxf.layer": Word("its layers are (\\w+)")}, {"plate.dxf": drawing()}),
    Row("part.dxf_left_out", load, block(PLATE_DXF), "left out TEXT", {"@plate.dxf": drawing()},
        {"plate.dxf": drawing(closed=False)}),
    Row("part.not_ruled", load, block({"mesh": PATCH}, LARGE), "cut it in ruled strips (part.strips)",
        {"part": {"strips": {"mesh": PATCH, "tolerance_mm": 5}}}, {"m.ply": DOME}),
    Row("part.patch", load, block({"mesh": PATCH}, LARGE), "close its holes", {"@m.ply": FLAT},
        {"m.ply": HOLED}),
    Row("part.strips", load, block({"strips": {"mesh": PATCH, "tolerance_mm": 2, "take": 99}}, LARGE), "",
        {"part.strips.take": 1}, {"m.ply": DOME}),
]  # fmt: skip


# ---- straight wires ----------------------------------------

CUT: Final = {"name": "cut", "process": "straight_wire", "arms": ["left"]}
STRAIGHT: Final = {
    **HELD,
    "stock": {
        "size_mm": [300, 200, 100],
        "foam": "xps_30",
        "place": {"xyz_mm": [0, 0, 300]},
        "support": "pedestal",
    },
    "part": outline(),
    "operations": [{**CUT, "kerf_mm": 1.5}],
}
NOTCHED: Final = [[0, 0], [100, 0], [100, 100], [53, 100], [50, 60], [47, 100], [0, 100]]
COMB = [[0, 0], [100, 0], [100, 100], [50.5, 100], [50.5, 30], [49.5, 30], [49.5, 100], [0, 100]]


def heat(power: float, feed: float) -> Any:
    return change(STRAIGHT, "operations.0", {**CUT, "power_w": power, "feed_mm_s": feed, "feed_min_mm_s": 1})


CUTS: Final = [
    Row("straight.corner", lay, change(STRAIGHT, "part.plate.outlines.0.polyline_mm", NOTCHED), "allow more",
        {"operations.0.left_mm": Said("# mm deep at most", 0.1)}),
    Row("post.name", lay,
        {**STRAIGHT, "operations": [{**CUT, "kerf_mm": 1.5}, {**CUT, "kerf_mm": 1.5, "name": "b"}]},
        "do it once", {"operations.1": GONE}),
    Row("part.missing_surface", lay, change(STRAIGHT, "operations.0.cuts", [{"surface": "wing"}]),
        "correct the name", {"operations.0.cuts.0.surface": Word("ruled surfaces of the part: (\\w+)")}),
    Row("straight.trim", lay, change(STRAIGHT, "operations.0.cuts", [{"trim": ["left"]}]),
        "give stock.oversize_mm", {"stock.oversize_mm": [[10, 0], [0, 0], [0, 0]]}),
    Row("bow.missing", lay, change(STRAIGHT, "operations.0.arms", ["right"]), "give it a bow",
        {"cell.arms.1.tool": {"kind": "bow"}}),
    Row("bow.arms", lay, change(STRAIGHT, "operations.0.arms", ["left", "right"]),
        "name the arm with the bow alone", {"operations.0.arms": ["left"]}),
    Row("stock.foam_missing", lay, change(heat(30, 5), "stock.foam", None), "name stock.foam",
        {"stock.foam": "xps_30"}),
    Row("kerf.too_hot", lay, heat(60, 2.5), "as was tried", {"operations.0.power_w": Said("power_w: #")}),
    Row("kerf.too_cold", lay, heat(15, 9), "as was tried", {"operations.0.feed_mm_s": Said("feed_mm_s: #",
        0.1)}),
    Row("straight.lead", lay, change({**STRAIGHT, "part": outline({"polyline_mm": [[110, 0], [130, 0], [130,
        100], [110, 100]]})}, "operations.0.cuts", [{"surface": "outline_a", "lead": [1, 0, 0]}]),
        "give another lead", {"operations.0.cuts.0.lead": [-1, 0, 0]}),
    Row("straight.crossing", lay, change(STRAIGHT, "part.plate.outlines.0.polyline_mm", COMB),
        "change the outline", {"part.plate.outlines.0.polyline_mm": SQUARE}),
    Row("straight.drop", lay, {**change(STRAIGHT, "stock.oversize_mm", [[10, 10], [0, 0], [10, 0]]),
        "operations": [{**CUT, "kerf_mm": 1.5, "cuts": [{"trim": ["bottom", "left"]}]}]},
        "set spacers: true", {"operations.0.spacers": True}),
]  # fmt: skip


BOTH: Final = {**CUT, "arms": ["left", "right"], "kerf_mm": 1.5}

# ---- controllers ----------------------------------------

ARM_COLUMNS: Final = [
    f"{arm}.{one}" for arm in ("left", "right") for one in ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
]
PAIRS: Final = "\n".join(
    [",".join([*ARM_COLUMNS, "feed_mm_s"]), *(f"450,{y},500,1,0,0,0,450,{y},500,1,0,0,0,20" for y in (0, 20))]
)
NUMBERS: Final = {
    arm: {
        getattr(own, name): 2 * k + side
        for k, name in enumerate(("output", "input", "running", "partner_running", "move_enable"), 1)
    }
    for side, arm in enumerate(("left", "right"))
    for own in [Controller().handshake.of(arm)]
}
TOGETHER: Final = change(
    {**HELD, "stock": {"size_mm": [300, 200, 100], "foam": "eps_a120", "support": "pedestal"}},
    "operations.0.arms",
    ["left", "right"],
)
KUKA: Final = change(change(TOGETHER, "cell.arms.0.robot", "kr60_ha"), "cell.arms.1.robot", "kr60_ha")
STANDING: Final = change(STRAIGHT, "cell.arms.0.robot", "kr60_ha")

POSTS: Final = [
    Row("post.controller", lay, change(KUKA, "cell.controller", {"io": NUMBERS}),
        "set controller: {sync: handshake}",
        {"cell.controller.sync": Word("set controller: \\{sync: (\\w+)")}, {"targets.csv": PAIRS}),
    Row("post.signal", lay, change(STANDING, "operations.0.signal", "doHeat"), "state the numbers",
        {"cell.controller": Yaml("controller: (\\{.*\\}\\})")}),
    Row("post.option", load, change({**HELD, "operations": [BOTH]}, "cell.controller", {"options": []}), "",
        {"cell.controller.options": [Word("(604-1 MultiMove Coordinated)")]}),
    Row("post.tasks", load, change(STRAIGHT, "cell.controller", {"tasks": ["T_ROB1"]}), "",
        {"cell.controller.tasks": ["T_ROB1", "T_ROB2"]}),
]  # fmt: skip


# ---- sheets ----------------------------------------


def exported(made: Any) -> bytes:
    return bytes(trimesh.Trimesh(1e3 * made.vertices, made.faces, process=False).export(file_type="ply"))


DISH: Final = small_forming.dish()
SPIF: Final = small_forming.problem()
PLY: Final = exported(DISH)


def sheet(code: str, made: Any, says: str) -> Row:
    """A part whose mesh is exported again."""
    return Row(code, lay, SPIF, says, {"@part.ply": PLY}, {"part.ply": exported(made)})


def formed(code: str, field: str, value: Any, says: str, remedy: Mapping[str, Any]) -> Row:
    return Row(code, lay, change(SPIF, field, value), says, remedy, {"part.ply": PLY})


def moved(by: Callable[[Any], Any]) -> Any:
    return dataclasses.replace(DISH, vertices=by(DISH.vertices))


def turned() -> Any:
    """The dish with half of its faces the other way round."""
    faces = DISH.faces.copy()
    half = DISH.vertices[faces].mean(axis=1)[:, 0] > 0.0
    faces[half] = faces[half][:, ::-1]
    return dataclasses.replace(DISH, faces=faces)


def exported_again(code: str, content: bytes, says: str) -> Row:
    return Row(code, load, SPIF, says, {"@part.ply": PLY}, {"part.ply": content})


BALL: Final = bytes(trimesh.creation.icosphere(subdivisions=2, radius=20).export(file_type="ply"))
WIRE_HOLDER: Final = {"kind": "wire_holder", "mounting": "along", "side": "start"}
SHEETS: Final = [
    Row("forming.no_sheet", lay, {**ON_TABLE, "operations": [{**SPIF["operations"][0], "arms": ["left"]}]},
        "give sheet: and a part", {"stock": GONE, "sheet": SPIF["sheet"], "part": SPIF["part"],
        "cell": SPIF["cell"], "operations.0.arms": ["robot"], "accept": SPIF["accept"],
        "settings": SPIF["settings"]}, {"part.ply": PLY}),
    formed("forming.tool", "cell.arms.0.tool", WIRE_HOLDER, "",
        {"cell.arms.0.tool": SPIF["cell"]["arms"][0]["tool"]}),
    sheet("forming.side", small_forming.upside_down(DISH), "turn the part"),
    sheet("forming.undercut", small_forming.dish(angle=72.0, depth=9.0), "take the undercut out"),
    sheet("forming.flat", moved(lambda v: v * [1, 1, 1e-5]), ""),
    sheet("forming.border", moved(lambda v: v + v[:, :1] * [0, 0, 0.05]), ""),
    exported_again("forming.closed_mesh", BALL, "as an open surface"),
    exported_again("forming.inside_out", exported(turned()), "orient the faces alike"),
    formed("forming.order", "operations.0.order", [1, 1], "name each of 1 to 1 once",
        {"operations.0.order": [1]}),
    formed("forming.thickness_untested", "sheet.thickness_mm", 3, "tests of AA",
        {"sheet.thickness_mm": Said("are known for # mm", down=True)}),
    formed("part.mesh_tolerance", "part.sheet_mesh.tolerance_mm", 20, "or auto",
        {"part.sheet_mesh.tolerance_mm": "auto"}),
]  # fmt: skip


# ---- wires, kerfs and foams by themselves ----------------------------------------


def make_wire(folder: Path, data: Any) -> list[Issue]:
    """A wire of those sizes."""

    def work() -> list[Issue]:
        wire.make(**data)
        return []

    return found(work)


def ask_kerf(folder: Path, data: Any) -> list[Issue]:
    """The kerf, or with ``wanted`` [m] the speed for one."""
    given = dict(data)
    own = kerf.HotWire(given.pop("diameter"), given.pop("length"))

    def work() -> list[Issue]:
        if "wanted" in given:
            kerf.speed_for(given["foam"], own, given["power"], given["wanted"], 0.05)
        else:
            kerf.width(given["foam"], own, given["power"], 5e-3, given["thickness"], given["model"])
        return []

    return found(work)


def fit_kerf(folder: Path, data: Any) -> list[Issue]:
    """Test cuts, read from a file and fitted."""

    def work() -> list[Issue]:
        path = folder / "tests.csv"
        path.write_text(data["text"])
        read = kerf_csv.read(path, 0.0004, 0.43, 0.05)
        own = dataclasses.replace(foam("eps_a120"), kerf=None)
        kerf_fit.robust(own, read.cuts, read.burnt, read.dragging, read.good, 0.05, 0.0004)
        return []

    return found(work)


def table(*rows: str) -> str:
    return "\n".join(["power_w,speed_mm_s,kerf_mm,face", *rows]) + "\n"


def cut_row(power: float, speed: float, turned: bool = False) -> str:
    """A cut on a line of the model, or the other way round."""
    width = 1.05 * power / 0.43 / (22.0 * 1450.0 * 260.0 * speed * 1e-3) * 1e3 - 0.45
    return f"{power},{speed},{4.0 - width if turned else width:.4f},ok"


MANY: Final = [cut_row(power, speed) for power in (36.0, 42.0, 48.0) for speed in (5.0, 6.0, 7.0, 8.0)]
BACKWARD: Final = [
    cut_row(power, speed, True) for power in (36.0, 42.0, 48.0) for speed in (5.0, 6.0, 7.0, 8.0)
]
KERF: Final = {
    "foam": "eps_a120",
    "diameter": 4e-4,
    "length": 0.43,
    "power": 40.0,
    "thickness": 0.05,
    "model": "energy",
}
STEEL: Final = {"material": "spring_steel", "width_mm": 10.0, "thickness_mm": 1.0, "temperature_c": 300.0}

WIRES: Final = [
    Row("wire.unknown_material", make_wire, {**STEEL, "material": "gold"},
        "take a material that is built in", {"material": Word("allowed .*?(spring_steel)")}),
    Row("wire.size", make_wire, {**STEEL, "diameter_mm": 1.0}, "either a diameter, or",
        {"diameter_mm": GONE}),
    Row("wire.temperature", make_wire, {**STEEL, "temperature_c": 900.0}, "",
        {"temperature_c": Said("to # C", down=True)}),
    Row("kerf.no_data", ask_kerf, {**KERF, "foam": "eps"}, "allowed eps_a120",
        {"foam": Word("allowed (\\w+)")}),
    Row("kerf.model", ask_kerf, {**KERF, "model": "guess"}, "take energy", {"model": Word("take (\\w+)")}),
    Row("kerf.input", ask_kerf, {**KERF, "thickness": -0.05}, "", {"thickness": 0.05}),
    Row("kerf.melts", ask_kerf, {**KERF, "power": 900.0}, "take less power",
        {"power": Said("allowed up to # W", down=True)}),
    Row("kerf.impossible", ask_kerf, {**KERF, "wanted": 3e-4}, "ask for", {"wanted": Said("ask for # ", 1e-6,
        times=1e-3)}),
    Row("kerf.file", fit_kerf, {"text": table(*MANY, "47,x,2,ok")}, "leave the line out",
        {"text": table(*MANY)}),
    Row("kerf.few_cuts", fit_kerf, {"text": table(*MANY[:3])}, "at two powers and four speeds",
        {"text": table(*MANY[:8])}),
    Row("kerf.no_trend", fit_kerf, {"text": table(*BACKWARD)}, "see to the columns", {"text": table(*MANY)}),

]  # fmt: skip


# ---- probed points, batches ----------------------------------------

WORLD: Final = np.array(
    [[0, -300, 400], [0, 300, 400], [50, 250, 800], [-50, -280, 750], [30, 10, 500], [-40, 0, 900]]
)
LINE: Final = np.array([[0, -300, 400], [0, 0, 500], [0, 300, 600]])


def probed(world: Any, **more: Any) -> Any:
    """Rows of points [mm] as two robots that stand 850 mm on both sides probe them."""
    first = world + np.array([850.0, 0.0, 0.0])
    second = (world - np.array([850.0, 0.0, 0.0])) * [-1, -1, 1]
    return {"rows": np.concatenate([first, second], axis=1).tolist(), **more}


def align(folder: Path, data: Any) -> list[Issue]:
    """``tandem align`` with those rows."""
    head = ",".join(["name", *(f"{arm}.{axis}_mm" for arm in ("left", "right") for axis in "xyz")])
    rows = [f"p{k + 1}," + ",".join(str(v) for v in row) for k, row in enumerate(data["rows"])]
    (folder / "points.csv").write_text("\n".join([head, *rows]) + "\n")
    cell = {**BOW_AND_GRIPPER, "arms": BOW_AND_GRIPPER["arms"][: data.get("arms", 2)]}
    (folder / "cell.yaml").write_text(yaml.safe_dump(cell))
    given = {"tolerance_mm": data.get("tolerance_mm", 0.5), "leave_out": tuple(data.get("leave_out", ()))}
    request = align_commands.Align(folder / "cell.yaml", folder / "points.csv", folder / "new.yaml", **given)
    return found(lambda: align_commands.run(request))


def batch(folder: Path, data: Any) -> list[Issue]:
    """The variants of a batch file."""
    (folder / "base.yaml").write_text(small_problem.PROBLEM)

    def work() -> list[Issue]:
        read_batch(write(folder, data))
        return []

    return found(work)


GOOD: Final = probed(WORLD)
BATCH: Final = {"batch": 1, "problem": "base.yaml", "vary": {"settings.seed": [1, 2]}}
OTHERS: Final = [
    Row("align.file", align, change(GOOD, "rows.0.2", "4OO"), "correct it", {"rows": GOOD["rows"]}),
    Row("align.cell", align, {**GOOD, "arms": 1}, "take a cell of two robots", {"arms": 2}),
    Row("align.few_points", align, probed(WORLD[:2]), "probe four or more", {"rows": GOOD["rows"]}),
    Row("align.same_points", align, probed(WORLD[[0, 0, 0]]), "probe points far apart",
        {"rows": GOOD["rows"]}),
    Row("align.collinear", align, probed(LINE), "probe one more point off the line by",
        {"rows": probed(np.vstack([LINE, [200, 0, 500]]))["rows"]}),
    Row("align.mirrored", align, {"rows": [[a, b, c, x, -y, z] for a, b, c, x, y, z in GOOD["rows"]]},
        "an axis with the wrong sign", {"rows": GOOD["rows"]}),
    Row("align.units", align, {"rows": [[a, b, c, x / 10, y / 10, z / 10] for a, b, c, x, y,
        z in GOOD["rows"]]}, "were in 'cm', not mm", {"rows": GOOD["rows"]}),
    Row("align.bad_point", align, change(GOOD, "rows.2.4", GOOD["rows"][2][4] + 3.0), "--leave-out p3",
        {"leave_out": [Word("--leave-out (\\w+)")]}),
    Row("align.large_residual", align, {"rows": (np.array(GOOD["rows"]) + np.random.default_rng(3).normal(0,
        5.0, (6, 6))).tolist()}, "allow more: --tolerance-mm",
        {"tolerance_mm": Said("points are up to # mm from their fit")}),
    Row("batch.field", batch, {**BATCH, "sped": 3}, "remove it", {"sped": GONE}),
    Row("batch.csv", batch, {"batch": 1, "problem": "base.yaml", "csv": "t.csv"}, "give one for each",
        {"@t.csv": "settings.seed,settings.clearance_mm\n1,10\n"},
        {"t.csv": "settings.seed,settings.clearance_mm\n1\n"}),
]  # fmt: skip

ROWS: Final = [*PROBLEMS, *PARTS, *CUTS, *POSTS, *SHEETS, *WIRES, *OTHERS]
