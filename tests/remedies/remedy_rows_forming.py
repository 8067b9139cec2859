"""Rows of ``test_remedies_of_data`` for forming: sheets, tools, dies, tables and requirements of paths."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely

from planner.catalogue.materials import sheet_metal
from planner.geometry.arrays import Mesh
from planner.geometry.units import DEG, MM
from planner.issues import Issue
from planner.processes.forming.plan import sheet_mechanics
from planner.processes.forming.plan.features import tree
from planner.processes.forming.plan.paths import adsif_response, contact_path
from planner.processes.forming.plan.paths.spiral import PathOptions
from tests import small_forming
from tests.processes.forming.plan import shapes
from tests.processes.forming.plan.paths.path_faces import bowl
from tests.refusals import change
from tests.remedies.advice import ReportedFigure, Word
from tests.remedies.remedy_rows import DISH, SPIF, Row, Yaml, collect_issues, export_ply, lay


@dataclasses.dataclass(frozen=True)
class Sum(ReportedFigure):
    """The sum of a figure of an issue's text and a known one."""

    besides: float = 0.0

    def of(self, issues: Any, now: Any) -> float:
        return super().of(issues, now) + self.besides


UP: Final = small_forming.upside_down(DISH)
STEEP: Final = small_forming.dish(36.0, 14.0, 70.0, 10.0)
CONE: Final = shapes.cone(30.0, 0.012, 0.04)
SQUARE: Final = shapely.box(-0.03, -0.03, 0.03, 0.03)


def row(code: str, says: str, remedy: Mapping[str, Any], data: Any, part: Mesh = DISH, **files: Mesh) -> Row:
    made = {f"{name}.ply": export_ply(mesh) for name, mesh in (files | {"part": part}).items()}
    return Row(code, lay, data, says, remedy, made)


def tool(data: Any, arm: int, **fields: Any) -> Any:
    return change(data, f"cell.arms.{arm}.tool", {**data["cell"]["arms"][arm]["tool"], **fields})


def die(kind: str, **more: Any) -> Any:
    stated = {"file": "die.ply", "unit": "mm", "kind": kind, "full": True}
    if kind == "male":
        stated |= {"holder": "sinking", "step_mm": 1}
    return small_forming.problem("tpif", die={**stated, **more})


def lower(mesh: Mesh, by: float = 0.02) -> Mesh:
    """The face of a die, some mm below the part's."""
    return dataclasses.replace(mesh, vertices=mesh.vertices - [0.0, 0.0, by * MM])


def wide(mode: str, **operation: Any) -> Any:
    """A sheet for larger parts."""
    data = small_forming.problem(mode, **operation)
    return change(data, "sheet", {**data["sheet"], "size_mm": [240, 240], "opening_mm": 160})


def dishes(distance: float) -> Mesh:
    """Return two pits, 40 mm across, whose centres are the given distance [mm] apart."""
    line = np.linspace(-0.06, 0.06, 121)
    x, y = np.meshgrid(line, line)
    near = np.minimum(np.hypot(x - 0.5 * distance * MM, y), np.hypot(x + 0.5 * distance * MM, y))
    z = np.interp(near, [0.0, 0.005, 0.020], [-0.006, -0.006, 0.0])
    at = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (part.ravel() for part in (at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([b, d, c])])
    return Mesh(np.column_stack([x.ravel(), y.ravel(), z.ravel()]), faces)


def torn_mesh(*faces: int) -> Mesh:
    return dataclasses.replace(DISH, faces=np.delete(DISH.faces, list(faces), axis=0))


DISK: Final = change(small_forming.problem("dpif_p"), "cell.arms.1.tool", dict(small_forming.DISK))
THICK: Final = tool(SPIF, 0, radius_mm=2, shaft_radius_mm=15, neck_mm=2.1)
SLIM: Final = tool(SPIF, 0, radius_mm=4.5, shaft_radius_mm=4.5)
TABLE: Final = adsif_response.BUILT_IN_FILE.read_text("utf-8")
CUSTOM_TABLE: Final = change(wide("adsif"), "operations.0.adsif", {"file": "own.csv"})
SOFT: Final = {"force_n": 12000, "stiffness_n_mm": 5000}
FILLETS: Final = small_forming.dish(30.0, 8.0, 45.0, 6.05)
STEPS: Final = change(die("male", step_mm=0.3), "operations.0.path", "contour")
SHEET: Final = {"sheet.opening_mm": Yaml(r"opening_mm: (\[[^]]*\]|[0-9.]+)"),
    "sheet.size_mm": Yaml(r"size_mm: (\[[^]]*\])")}  # fmt: skip
ADSIF: Final = {"part.ply": export_ply(CONE)}

JOBS: Final = [
    row("forming.wall_angle", "make the wall less steep", {"@part.ply": export_ply(shapes.pit(SQUARE, 60.0,
        0.006))}, SPIF, shapes.pit(SQUARE, 89.9, 0.006)),
    row("forming.shift", "reduce shift_deg",
        {"operations.0.shift_deg": ReportedFigure("allowed is 0 to #", 0.1, down=True)},
        small_forming.problem("dpif_l", shift_deg=41)),
    row("forming.clamp", "make the opening", {"sheet.opening_mm": Sum("make the opening # mm wider",
        more=True, besides=10.0), "sheet.size_mm": [240, 240]}, DISK),
    row("part.stock_too_small", "with space for the tools (tried)", SHEET, change(DISK,
        "sheet.opening_mm", 56)),
    row("part.stock_too_small", "with space for the tools (tried)", SHEET, change(SPIF, "sheet.opening_mm",
        [70, 50])),
    row("forming.hole", "close it", {"@part.ply": export_ply(DISH)}, SPIF, torn_mesh(700)),
    row("forming.hole", "meet in a point", {"@part.ply": export_ply(DISH)}, SPIF, torn_mesh(700, 701)),
]  # fmt: skip
DIES: Final = [
    row("forming.die_far", "state full: false", {"operations.0.die.full": False}, die("female"), DISH,
        die=lower(DISH, 3.0)),
    row("forming.holder", "penetrates the flat sheet", {"operations.0.die.holder":
        Word("state holder: (\\w+)")}, die("male", holder="fixed"), UP, die=lower(UP)),
    row("forming.holder", "a clamp that sinks", {"operations.0.die.holder": Word("state holder: (\\w+)")},
        die("female", holder="sinking", step_mm=1), DISH, die=lower(DISH)),
    row("forming.holder_step", "use path: helical", {"operations.0.path": Word("use path: (\\w+)")},
        change(STEPS, "operations.0.stepdown_mm", 2.5), UP, die=lower(UP)),
]  # fmt: skip
LONG: Final = [
    row("forming.wall_angle", "use passes: auto", {"operations.0.passes": Word("use passes: (auto)")},
        change(SLIM, "operations.0.passes", [70]), STEEP),
    row("forming.support_radius", "the largest that fits", {"cell.arms.1.tool.radius_mm":
        ReportedFigure("largest that fits is # mm", 0.01, down=True)}, small_forming.problem("dsif"),
        FILLETS),
    row("forming.support_tool", "needs two balls", {"cell.arms.1.tool.radius_mm":
        ReportedFigure("mount a ball of # mm")}, tool(wide("adsif"), 1, radius_mm=6), CONE),
    row("forming.clear", "slimmer tool",
        {"cell.arms.0.tool.shaft_radius_mm": ReportedFigure("shaft_radius_mm: #", 0.1, down=True)}, THICK),
    row("forming.unreached", "unreached_mm allows",
        {"operations.0.unreached_mm": ReportedFigure("or allow # mm", 0.001)},
        small_forming.problem(unreached_mm=0.1), shapes.pit(SQUARE, 40.0, 0.006)),
    row("forming.touching", "leave a strip of flat", {"@part.ply": export_ply(dishes(42.0))}, wide("spif"),
        dishes(40.0)),
    row("forming.die_gouge", "protrudes 0.98 mm into the part", {"@die.ply": export_ply(lower(DISH))},
        die("female"), DISH, die=lower(DISH, -0.98)),
    row("forming.die_far", "check its unit", {"operations.0.die.unit": "mm"}, die("female", unit="cm"), DISH,
        die=lower(DISH)),
    row("forming.holder_step", "divides the depth", {"operations.0.die.step_mm": 3}, die("male", step_mm=4),
        UP, die=lower(UP)),
    Row("forming.adsif_table", lay, CUSTOM_TABLE, "add a line '# metal: ...'", {"@own.csv": TABLE},
        {**ADSIF, "own.csv": TABLE.replace("# metal: aa5754_o\n", "")}),
    Row("forming.adsif_conditions", lay, change(wide("adsif"), "sheet.metal", "aa1100_o"),
        "use the conditions of the table", {"sheet.metal": Word("is valid for '(\\w+)'")}, ADSIF),
    Row("forming.adsif_compliance", lay, change(wide("adsif"), "operations.0.adsif", SOFT),
        "state a smaller force", {"operations.0.adsif.force_n": ReportedFigure("mm to # mm: state", down=True,
        times=5000.0)}, ADSIF),
]  # fmt: skip


# ---- the functions themselves ----------------------------------------


def refusal(work: Callable[[], object]) -> list[Issue]:
    """Return the issues of a refusal."""

    def done() -> list[Issue]:
        work()
        return []

    return collect_issues(done)


def respond(folder: Path, data: Any) -> list[Issue]:
    """The wall angle at a position [deg] and a gap over the thickness."""
    table = adsif_response.built_in_table()
    return refusal(lambda: adsif_response.formed_wall_angle(table, data["position"] * DEG, data["gap"]))


def estimate(folder: Path, data: Any) -> list[Issue]:
    """The force of a step [mm] on walls of 40 degrees."""
    metal = sheet_metal("aa1100_o")
    return refusal(
        lambda: sheet_mechanics.estimate_force(metal, MM, 12 * MM, data["step"] * MM, [40.0 * DEG])
    )


def features(folder: Path, data: Any) -> list[Issue]:
    return refusal(lambda: tree.build_feature_tree(DISH, data["step"] * MM))


def path(folder: Path, data: Any) -> list[Issue]:
    """A path over a bowl, its outline moved aside or faces of it left out."""
    one = bowl(0.03, 0.01, count=60, walls=16)
    faces = np.delete(one.faces, data["torn"], axis=0)
    one = dataclasses.replace(one, region=one.region + data["aside"] * MM, faces=faces)
    options = PathOptions(stepdown=data["step"] * MM)
    return refusal(lambda: contact_path.make_contact_path(one, 0.005, options))


BOWL: Final = {"step": 1.0, "aside": 0.0, "torn": []}
CALLS: Final = [
    Row("forming.adsif_unstable", respond, {"position": 30.0, "gap": 0.65}, "the sheet buckles",
        {"gap": ReportedFigure("use a gap of #", 0.01)}),
    Row("forming.force_input", estimate, {"step": -1.0}, "correct it", {"step": 1.0}),
    Row("forming.step", features, {"step": 1e-9}, "state a larger one",
        {"step": 1.0}),
    Row("forming.path_options", path, {**BOWL, "step": 1e-4}, "use a stepdown of",
        {"step": 1.0}),
    Row("forming.no_contour", path, {**BOWL, "aside": 1e3}, "check that levels and outline",
        {"aside": 0.0}),
    Row("forming.open_contour", path, {**BOWL, "torn": [500]}, "close it", {"torn": []}),
]  # fmt: skip
ROWS: Final = [*JOBS, *DIES, *CALLS, *(dataclasses.replace(row, long=True) for row in LONG)]
