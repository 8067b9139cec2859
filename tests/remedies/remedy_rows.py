"""Rows of ``test_remedies_of_data``: bad data of every room, and the advice of its issue."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import trimesh
import yaml

from planner import pipeline
from planner.catalogue.materials import foam
from planner.issues import Issue, TandemError
from planner.languages.writing import write as post
from planner.processes import registry
from planner.processes.hotwire.plan import wire
from planner.processes.hotwire.plan.kerf import calibration
from planner.processes.hotwire.plan.kerf import width as kerf_width
from tests import small_forming, small_problem
from tests.reading import test_grip_choice as test_gripping
from tests.reading.part_specs import SQUARE, WING, outline
from tests.reading.test_setups import CELL as BOW_AND_GRIPPER
from tests.refusals import POSES, change
from tests.remedies.advice import ReportedFigure, Word

GONE: Final = object()
"""In a remedy: the field is taken out."""
How = Callable[[Path, Any], list[Issue]]


@dataclasses.dataclass(frozen=True)
class Row:
    """One fault and its remedy.

    ``how`` finds the issues of ``data`` in a folder with ``files``. ``says`` is part of the issue with that
    ``code``, and ``remedy`` applies it to fields of the data, or to files by ``@name``. ``long``: it takes
    seconds.
    """

    code: str
    how: How
    data: Any
    says: str
    remedy: Mapping[str, Any]
    files: Mapping[str, str | bytes] = dataclasses.field(default_factory=dict)
    long: bool = False


@dataclasses.dataclass(frozen=True)
class Yaml(Word):
    """A value that is extracted from an issue as it would be in the file, by a pattern with one group."""

    def of(self, issues: Sequence[Issue], now: Any) -> Any:
        return yaml.safe_load(super().of(issues, now))


def collect_issues(work: Callable[[], Iterable[Issue]]) -> list[Issue]:
    """Return the issues that a function returns or raises."""
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
    return collect_issues(lambda: pipeline._input_notes(pipeline.load(write(folder, data))))


def check(folder: Path, data: Any) -> list[Issue]:
    """Return the issues of ``tandem check``."""
    return collect_issues(lambda: pipeline.check(pipeline.load(write(folder, data))))


def lay(folder: Path, data: Any) -> list[Issue]:
    """Return the issues of loading and of the targets of all operations: a check without the motion."""

    def work() -> Iterable[Issue]:
        problem = pipeline.load(write(folder, data))
        targets = pipeline.create_targets(problem, registry.jobs(problem))
        told = [
            *pipeline._input_notes(problem),
            *pipeline._support_issues(problem),
            *(i for t in targets for i in t.issues),
        ]
        return [*told, *post.refusals(problem, targets)]

    return collect_issues(work)


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
    Row("problem.accepted", check, {**ON_TABLE, "accept": ["straight.drop"]}, "remove it",
        {"accept": GONE}),
    Row("problem.too_large", load, {**POSES, "part": {"wing": {**WING, "root": {"file": "a.dat",
        "chord_mm": 200}}}}, "", {"@a.dat": "", "part": GONE}, {"a.dat": "0.5 0.5\n" * 300_000}),
    Row("stock.gripper", load, change(HELD, "stock.held_by", "left"), "give it a gripper_plate",
        {"cell.arms.0.tool": {"kind": Word("give it a (\\w+)")}}),
    Row("stock.foam_missing", load, change(HELD, "stock.foam", None), "state its foam",
        {"stock.foam": "eps_a120"}),
    Row("stock.grip_force", load, change(HELD, "cell.arms.1.tool", {"kind": "vacuum_cup", "holding_n": 3.8}),
        "mount it", {"cell.arms.1.tool": {"kind": "gripper_plate", "width_mm": ReportedFigure("width_mm: #"),
        "depth_mm": ReportedFigure("depth_mm: #")}}),
    Row("stock.grip_chosen", load, test_gripping.data(test_gripping.WEDGE, test_gripping.LIST), "state it",
        {"stock.gripper": Word("state it: {gripper: (\\w+)"),
        "stock.grip": Yaml("grip: ({xyz_mm: .*?\\})")}),
    Row("problem.field", load, change(POSES, "cell.wires", []), "remove the key", {"cell.wires": GONE}),
    Row("stock.support", check, change(HUNG, "stock.support", [{"kind": "box", "size_mm": [50, 50, 50],
        "pose": {"xyz_mm": [0, 0, -25]}}]), "support: pedestal",
        {"stock.support": Word("support: (pedestal)")}),
    Row("stock.hangs", check, HUNG, "support: pedestal", {"stock.support": Word("support: (pedestal)")}),
    Row("cell.body_name", check, change(ON_TABLE, "cell.obstacles", [{**OBSTACLE, "name": "stock"}]), "",
        {"cell.obstacles.0.name": "pole"}),
    Row("targets.file", lay, POSES, "correct it", {"@targets.csv": TABLE},
        {"targets.csv": TABLE.replace("500,", "abc,", 1)}),
    Row("targets.held", lay, HELD, "Leave out stock.held_by", {"stock.held_by": GONE,
        "stock.support": Word("support: (pedestal)")}),
    Row("targets.freedom", lay, change(POSES, "operations.0.free", [{**FREE, "slide_mm": [0, 1]}]),
        "one of them", {"operations.0.free.0.slide_mm": GONE}),
    Row("kerf.unknown_foam", load, change(HELD, "stock.foam", "granite"), "a built-in foam",
        {"stock.foam": Word("got 'granite', allowed \\w+, (\\w+)")}),
    Row("kerf.foam_file", load, change(HELD, "stock.foam", {"file": "mine.yaml"}), "add it",
        {"@mine.yaml": FOAM_FILE + "density_kg_m3: 17\n"}, {"mine.yaml": FOAM_FILE}),
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
        {"operations.0.left_mm": ReportedFigure("at most # mm deep", 0.1)}),
    Row("post.name", lay,
        {**STRAIGHT, "operations": [{**CUT, "kerf_mm": 1.5}, {**CUT, "kerf_mm": 1.5, "name": "b"}]},
        "remove one of them", {"operations.1": GONE}),
    Row("part.missing_surface", lay, change(STRAIGHT, "operations.0.cuts", [{"surface": "wing"}]),
        "correct the name", {"operations.0.cuts.0.surface": Word("ruled surfaces of the part: (\\w+)")}),
    Row("straight.trim", lay, change(STRAIGHT, "operations.0.cuts", [{"trim": ["left"]}]),
        "state stock.oversize_mm", {"stock.oversize_mm": [[10, 0], [0, 0], [0, 0]]}),
    Row("bow.missing", lay, change(STRAIGHT, "operations.0.arms", ["right"]), "mount a bow",
        {"cell.arms.1.tool": {"kind": "bow"}}),
    Row("bow.arms", lay, change(STRAIGHT, "operations.0.arms", ["left", "right"]),
        "name only the arm with the bow", {"operations.0.arms": ["left"]}),
    Row("stock.foam_missing", lay, change(heat(30, 5), "stock.foam", None), "state stock.foam",
        {"stock.foam": "xps_30"}),
    Row("kerf.too_hot", lay, heat(60, 2.5), "which was tried",
        {"operations.0.power_w": ReportedFigure("power_w: #")}),
    Row("kerf.too_cold", lay, heat(15, 9), "which was tried",
        {"operations.0.feed_mm_s": ReportedFigure("feed_mm_s: #", 0.1)}),
    Row("straight.lead", lay, change({**STRAIGHT, "part": outline({"polyline_mm": [[110, 0], [130, 0], [130,
        100], [110, 100]]})}, "operations.0.cuts", [{"surface": "outline_a", "lead": [1, 0, 0]}]),
        "state another lead", {"operations.0.cuts.0.lead": [-1, 0, 0]}),
    Row("straight.crossing", lay, change(STRAIGHT, "part.plate.outlines.0.polyline_mm", COMB),
        "change the outline", {"part.plate.outlines.0.polyline_mm": SQUARE}),
    Row("straight.drop", lay, {**change(STRAIGHT, "stock.oversize_mm", [[10, 10], [0, 0], [10, 0]]),
        "operations": [{**CUT, "kerf_mm": 1.5, "cuts": [{"trim": ["bottom", "left"]}]}]},
        "set spacers: true", {"operations.0.spacers": True}),
]  # fmt: skip


BOTH: Final = {**CUT, "arms": ["left", "right"], "kerf_mm": 1.5}

# ---- sheets ----------------------------------------


def export_ply(mesh: Any) -> bytes:
    return bytes(trimesh.Trimesh(1e3 * mesh.vertices, mesh.faces, process=False).export(file_type="ply"))


DISH: Final = small_forming.dish()
SPIF: Final = small_forming.problem()
PLY: Final = export_ply(DISH)


def sheet(code: str, mesh: Any, says: str) -> Row:
    """A part whose mesh is exported again."""
    return Row(code, lay, SPIF, says, {"@part.ply": PLY}, {"part.ply": export_ply(mesh)})


def forming_row(code: str, field: str, value: Any, says: str, remedy: Mapping[str, Any]) -> Row:
    return Row(code, lay, change(SPIF, field, value), says, remedy, {"part.ply": PLY})


def move_dish(by: Callable[[Any], Any]) -> Any:
    return dataclasses.replace(DISH, vertices=by(DISH.vertices))


def half_flipped_dish() -> Any:
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
    forming_row("forming.tool", "cell.arms.0.tool", WIRE_HOLDER, "",
        {"cell.arms.0.tool": SPIF["cell"]["arms"][0]["tool"]}),
    sheet("forming.side", small_forming.upside_down(DISH), "turn the part"),
    sheet("forming.undercut", small_forming.dish(angle=72.0, depth=9.0), "remove the undercut"),
    sheet("forming.flat", move_dish(lambda v: v * [1, 1, 1e-5]), ""),
    sheet("forming.border", move_dish(lambda v: v + v[:, :1] * [0, 0, 0.05]), ""),
    exported_again("forming.closed_mesh", BALL, "as an open surface"),
    exported_again("forming.inside_out", export_ply(half_flipped_dish()), "orient the faces consistently"),
    forming_row("forming.order", "operations.0.order", [1, 1], "name each of 1 to 1 once",
        {"operations.0.order": [1]}),
    forming_row("forming.thickness_untested", "sheet.thickness_mm", 3, "tests of AA",
        {"sheet.thickness_mm": ReportedFigure("are known for # mm", down=True)}),
    forming_row("part.mesh_tolerance", "part.sheet_mesh.tolerance_mm", 20, "or auto",
        {"part.sheet_mesh.tolerance_mm": "auto"}),
]  # fmt: skip


# ---- wires, kerfs and foams by themselves ----------------------------------------


def make_wire(folder: Path, data: Any) -> list[Issue]:
    """A wire of those sizes."""

    def work() -> list[Issue]:
        wire.make_wire(**data)
        return []

    return collect_issues(work)


def ask_kerf(folder: Path, data: Any) -> list[Issue]:
    """Compute the kerf or, with ``wanted`` [m], the speed for that kerf."""
    given = dict(data)
    own = kerf_width.HotWire(given.pop("diameter"), given.pop("length"))

    def work() -> list[Issue]:
        if "wanted" in given:
            kerf_width.speed_for(given["foam"], own, given["power"], given["wanted"], 0.05)
        else:
            kerf_width.width(given["foam"], own, given["power"], 5e-3, given["thickness"], given["model"])
        return []

    return collect_issues(work)


def fit_kerf(folder: Path, data: Any) -> list[Issue]:
    """Test cuts, read from a file and fitted."""

    def work() -> list[Issue]:
        path = folder / "tests.csv"
        path.write_text(data["text"])
        read = calibration.read_cuts(path, 0.0004, 0.43, 0.05)
        own = dataclasses.replace(foam("eps_a120"), kerf=None)
        calibration.fit_robust(own, read, 0.0004)
        return []

    return collect_issues(work)


def table(*rows: str) -> str:
    return "\n".join(["power_w,speed_mm_s,kerf_mm,face", *rows]) + "\n"


def cut_row(power: float, speed: float, is_reversed: bool = False) -> str:
    """A cut on a line of the model, or the other way round."""
    width = 1.05 * power / 0.43 / (22.0 * 1450.0 * 260.0 * speed * 1e-3) * 1e3 - 0.45
    return f"{power},{speed},{4.0 - width if is_reversed else width:.4f},ok"


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
        "use a built-in material", {"material": Word("allowed .*?(spring_steel)")}),
    Row("wire.size", make_wire, {**STEEL, "diameter_mm": 1.0}, "either a diameter, or",
        {"diameter_mm": GONE}),
    Row("wire.temperature", make_wire, {**STEEL, "temperature_c": 900.0}, "",
        {"temperature_c": ReportedFigure("to # C", down=True)}),
    Row("kerf.no_data", ask_kerf, {**KERF, "foam": "eps"}, "allowed eps_a120",
        {"foam": Word("allowed (\\w+)")}),
    Row("kerf.model", ask_kerf, {**KERF, "model": "guess"}, "use energy", {"model": Word("use (\\w+)")}),
    Row("kerf.input", ask_kerf, {**KERF, "thickness": -0.05}, "", {"thickness": 0.05}),
    Row("kerf.melts", ask_kerf, {**KERF, "power": 900.0}, "use less power",
        {"power": ReportedFigure("allowed up to # W", down=True)}),
    Row("kerf.impossible", ask_kerf, {**KERF, "wanted": 3e-4}, "require",
        {"wanted": ReportedFigure("require # ", 1e-6, times=1e-3)}),
    Row("kerf.file", fit_kerf, {"text": table(*MANY, "47,x,2,ok")}, "remove the line",
        {"text": table(*MANY)}),
    Row("kerf.few_cuts", fit_kerf, {"text": table(*MANY[:3])}, "at two powers and four speeds",
        {"text": table(*MANY[:8])}),
    Row("kerf.no_trend", fit_kerf, {"text": table(*BACKWARD)}, "check the columns", {"text": table(*MANY)}),

]  # fmt: skip


ROWS: Final = [*PROBLEMS, *CUTS, *SHEETS, *WIRES]
