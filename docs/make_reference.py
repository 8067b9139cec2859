"""Write tables from the code into ``docs/``: fields of problem and batch files, rules of the proof, codes.

Run ``python docs/make_reference.py`` after a change of a schema. A test compares the files with its output.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from planner.batch import batch_file
from planner.issue_codes import CODES
from planner.processes.forming.plan import operation as forming
from planner.processes.hotwire.plan import operation
from planner.processes.milling.plan import operation as milling_operation
from planner.processes.poses.plan import job
from planner.processes.trim.plan import operation as trim_operation
from planner.proof import rule_table
from planner.reading import (
    cell,
    controller,
    drawing_file,
    part_ruled,
    part_surfaces,
    problem,
    process_forces,
    rail_axes,
    rhino,
    robot_file,
    rotary_axes,
    sheet,
    step,
    stock,
)
from planner.reading import part as part_file

DOCS_FOLDER = Path(__file__).parent
PACKAGE = DOCS_FOLDER.parent / "planner"
START, END = "<!-- written by make_reference.py -->", "<!-- end of what make_reference.py writes -->"

CHAPTERS: tuple[tuple[str, str, type[BaseModel]], ...] = (
    ("The whole file", "", problem.ProblemFile),
    ("`stock`", "", stock.StockFile),
    ("`setup` of an operation", "setup", stock.SetupFile),
    ("`forces` of an operation, by arm", "forces", process_forces.ForceFile),
    ("`foam` of `stock`, a file", "", stock.FoamReference),
    ("`sheet`", "", sheet.SheetFile),
    ("`sheet.clamp`", "", sheet.ClampFile),
    ("`settings`", "", problem.SettingsFile),
    ("`part`", "", part_file.PartFile),
    ("`part.front`", "", part_surfaces.FrontFile),
    ("`part.front.loft`, `part.strips.loft`", "", part_surfaces.LoftFile),
    ("`part.front.loft.rail`", "", part_surfaces.RailFile),
    ("`part.front.loft.profiles` and `sections`, each", "", part_surfaces.CurveFile),
    ("`part.front.loft.region`", "", part_surfaces.RegionFile),
    ("`part.front.mesh`, `part.back.mesh`, `part.strips.mesh`", "", part_surfaces.FaceMeshFile),
    ("`part.back`", "", part_surfaces.BackFile),
    ("`part.ruled`, each", "", part_ruled.RuledFile),
    ("`start` and `end` of `part.ruled`", "", part_ruled.GuideFile),
    ("`dxf` of a guide", "", part_ruled.DxfFile),
    ("`rhino` of `part.ruled`, each", "", rhino.RhinoRuledFile),
    ("`step` of `part.ruled`, each", "", step.StepRuledFile),
    ("`step` of `part.front`, `part.back` and `part.strips`", "", step.StepFaceFile),
    ("`rhino` of a guide and of `part.plate`", "", rhino.RhinoFile),
    ("`rhino` of `part.front`, `part.back` and `part.strips`", "", rhino.RhinoFaceFile),
    ("`part.wing`", "", part_ruled.WingFile),
    ("`root` and `tip` of `part.wing`", "", part_ruled.SectionFile),
    ("`part.plate`", "", part_file.PlateFile),
    ("`part.plate.outlines`, each", "", part_file.OutlineFile),
    ("`circle` of an outline", "", part_file.CircleFile),
    ("`part.plate.dxf`", "", part_file.PlateDxfFile),
    ("`part.mesh`", "", part_surfaces.RuledMeshFile),
    ("`part.strips`", "", part_surfaces.StripsFile),
    ("`part.sheet_mesh`", "", sheet.SheetMeshFile),
    ("`part.in_stock`", "", part_file.PlaceFile),
    ("Process `elastic_wire`", "elastic_wire", operation.ElasticWire),
    ("`wire` of `elastic_wire`", "", operation.WireFile),
    ("Process `straight_wire`", "straight_wire", operation.Straight),
    ("`cuts` of `straight_wire`: a surface", "", operation.SurfaceCut),
    ("`cuts` of `straight_wire`: sides of the block", "", operation.TrimCut),
    ("Process `forming`", "forming", forming.Forming),
    ("`adsif` of `forming`", "", forming.Adsif),
    ("`die` of `forming`", "", forming.Die),
    ("`springback` of `forming`", "", forming.Springback),
    ("`scan` of `springback`", "", forming.PartScan),
    ("`force_by` of `forming`", "", forming.ForceBy),
    ("`level` of `forming`", "", forming.Level),
    ("Process `milling`", "milling", milling_operation.Milling),
    ("`cuts` of `milling`: a flank", "", milling_operation.FlankCut),
    ("`cuts` of `milling`: lines", "", milling_operation.LinesCut),
    ("`cuts` of `milling`: an engraving", "", milling_operation.EngraveCut),
    ("`engrave` and `axis_curves` of an engraving", "", milling_operation.EngravedFile),
    ("`cuts` of `milling`: a G-code file", "", milling_operation.GCodeCut),
    ("`gcode` of such a cut", "", milling_operation.GCodeFile),
    ("Process `trim`", "trim", trim_operation.Trim),
    ("`outlines` of `trim`, each", "", trim_operation.OutlineFile),
    ("`circle` of such an outline", "", trim_operation.CircleFile),
    ("`drawing` of such an outline, or of an engraving", "", drawing_file.DrawingFile),
    ("`lead` of `trim`", "", trim_operation.LeadFile),
    ("`pierce` of `trim`", "", trim_operation.PierceFile),
    ("`by` of `trim`, `kind: torch`", "", trim_operation.TorchCut),
    ("`by` of `trim`, `kind: mill`", "", trim_operation.MillCut),
    ("`by` of `trim`, `kind: knife`", "", trim_operation.KnifeCut),
    ("Process `targets`", "process-targets", job.Posed),
    ("`free` of `targets`, each", "", job.FreeAxis),
    ("`cell`, or the file that it names", "cell", cell.CellFile),
    ("`cell.arms`, each", "", cell.ArmFile),
    ("`track` of an arm", "", rail_axes.TrackFile),
    ("`axes` of an arm, of a gantry", "", rail_axes.GantryAxisFile),
    ("`turntable` of a cell", "", rotary_axes.TurntableFile),
    ("`positioner` of a cell", "", rotary_axes.PositionerFile),
    ("`tilt` of a positioner", "", rotary_axes.TiltFile),
    ("`plate` of a turntable", "", rotary_axes.TurntablePlateFile),
    ("`robot` of an arm, one of your own", "", robot_file.OwnRobotFile),
    ("`meshes` of `robot`, each", "", robot_file.LinkMeshFile),
    ("`stiffness` of an arm", "", cell.StiffnessFile),
    ("`compensate_sag` of an arm", "", cell.SagFile),
    ("Tool `wire_holder`", "", cell.WireHolderFile),
    ("Tool `bow`", "", cell.BowFile),
    ("Tool `gripper_plate`", "", cell.GripperPlateFile),
    ("Tool `vacuum_cup`", "", cell.VacuumCupFile),
    ("Tool `ball_tool`", "", cell.BallToolFile),
    ("Tool `disk_tool`", "", cell.DiskToolFile),
    ("Tool `heat_tool`", "", cell.HeatToolFile),
    ("Tool `mill`", "", cell.MillFile),
    ("`holder` of `mill`, each", "", cell.HolderPieceFile),
    ("Tool `torch`", "", cell.TorchFile),
    ("Tool `knife`", "", cell.KnifeFile),
    ("Tool `plain`", "", cell.PlainToolFile),
    ("`cell.obstacles`, each", "", cell.ObstacleFile),
    ("`cell.wires`, each", "", cell.WiresFile),
    ("`cell.controller`", "", controller.ControllerFile),
    ("`cell.controller.interlock`", "", controller.InterlockFile),
    ("`outputs` of `interlock`, by request", "", controller.PowerOutputFile),
    ("`places` of `interlock`, by arm and signal", "", controller.DevicePlaceFile),
    ("`cell.controller.handshake`", "", controller.HandshakeFile),
    ("`signals` of `handshake`, by arm", "", controller.SignalsFile),
    ("`wires` of `handshake`, each", "", controller.SignalWireFile),
    ("`output` and `input` of a wire", "", controller.WireEndFile),
    ("Shape `box`", "", cell.BoxFile),
    ("Shapes `cylinder` and `capsule`", "", cell.RoundFile),
    ("Shape `sphere`", "", cell.SphereFile),
    ("Shape `mesh`", "", cell.MeshFile),
    ("A pose", "", cell.PoseFile),
)


def fields() -> str:
    """Return the tables of all chapters as Markdown."""
    return "\n".join(_chapter(title, anchor, model) for title, anchor, model in CHAPTERS)


def rules() -> str:
    """Return the table of the rules of the proof."""
    rows = [f"| `{code}` | {rule.title} |" for code, rule in rule_table.built_in().items()]
    return "\n".join(["| rule | what it asks |", "|---|---|", *rows, ""])


def batch_fields() -> str:
    """Return the tables of a batch file."""
    return "\n".join([_table(batch_file.BatchFile), "A range of `vary`:", "", _table(batch_file.RangeFile)])


def code_index() -> str:
    """Return the files of all rules and issue codes, as two tables."""
    texts = {path.relative_to(PACKAGE).as_posix(): path.read_text("utf-8") for path in PACKAGE.rglob("*.py")}
    return "\n".join(
        [
            "## Rules",
            "",
            "A rule is a function decorated with `@rule`. Codes are listed without `verify.`.",
            "",
            _rule_index(texts),
            "## Other issue codes",
            "",
            "Grouped by the first word of the code, which names the subject and not always the folder.",
            "",
            _issue_index(texts),
        ]
    )


def _rule_index(texts: dict[str, str]) -> str:
    """Rules by file."""
    rows = []
    for file, text in sorted(texts.items()):
        codes = re.findall(r'^@rule\(\s*"verify\.([\w.]+)"', text, re.MULTILINE)
        if codes:
            rows.append(f"| `{file}` | {', '.join(codes)} |")
    return "\n".join(["| file | rules |", "|---|---|", *rows, ""])


def _issue_index(texts: dict[str, str]) -> str:
    """Issue codes other than those of rules, by subject and file."""
    rows: dict[str, dict[str, list[str]]] = {}
    for code in sorted(code for code in CODES if not code.startswith("verify.")):
        subject, _, name = code.partition(".")
        for file, text in sorted(texts.items()):
            if f'"{code}"' in text and "/issue_codes/" not in file:
                rows.setdefault(subject, {}).setdefault(file, []).append(name)
    lines = [f"| `{subject}` | {_by_file(files)} |" for subject, files in rows.items()]
    return "\n".join(["| code | files |", "|---|---|", *lines, ""])


def _by_file(files: dict[str, list[str]]) -> str:
    return "<br>".join(f"`{file}`: {', '.join(names)}" for file, names in sorted(files.items()))


PAGES: dict[str, Callable[[], str]] = {
    "problem_file.md": fields,
    "proof.md": rules,
    "batch.md": batch_fields,
    "code_index.md": code_index,
}


def page(name: str, old: str) -> str:
    """Return the page with its tables replaced."""
    head, rest = old.split(START)
    _, after = rest.split(END)
    return f"{head}{START}\n\n{PAGES[name]()}\n{END}{after}"


def _chapter(title: str, anchor: str, model: type[BaseModel]) -> str:
    mark = f'<a id="{anchor}"></a>\n\n' if anchor else ""
    text = " ".join((model.__doc__ or "").split())
    return "\n".join([f"{mark}### {title}", "", text, "", _table(model)])


def _table(model: type[BaseModel]) -> str:
    schema = model.model_json_schema()
    required = set(schema.get("required", ()))
    lines = ["| field | what | default |", "|---|---|---|"]
    for name, field in schema.get("properties", {}).items():
        shown = _plain(field.get("default"))
        default = "required" if name in required else shown if shown == "see below" else f"`{shown}`"
        what = "; ".join(part for part in (field.get("description", ""), _kind(field, schema)) if part)
        lines.append(f"| `{name}` | {what} | {default} |")
    return "\n".join([*lines, ""])


def _kind(field: dict[str, Any], schema: dict[str, Any]) -> str:
    if "const" in field:
        return f"`{field['const']}`"
    if "enum" in field:
        return ", ".join(f"`{v}`" for v in field["enum"])
    if "$ref" in field:
        name = field["$ref"].rsplit("/", 1)[1]
        return (
            _kind(schema["$defs"][name], schema) if "enum" in schema["$defs"][name] else "mapping, see below"
        )
    for key in ("anyOf", "oneOf"):
        if key in field:
            kinds = [_kind(option, schema) for option in field[key] if option.get("type") != "null"]
            return " or ".join(dict.fromkeys(kinds))
    if field.get("type") == "array":
        if "prefixItems" in field:
            return f"list of {len(field['prefixItems'])}"
        inner = _kind(field.get("items", {}), schema)
        return f"list, each: {inner}" if inner else "list"
    return _range(field)


def _range(field: dict[str, Any]) -> str:
    words = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true or false"}
    kind = words.get(str(field.get("type", "")), "mapping" if field.get("type") == "object" else "")
    bounds = [
        f"{sign} {field[key]:g}"
        for key, sign in (
            ("exclusiveMinimum", "above"),
            ("minimum", "at least"),
            ("exclusiveMaximum", "below"),
            ("maximum", "at most"),
        )
        if key in field
    ]
    return " ".join([kind, ", ".join(bounds)]).strip()


def _plain(value: Any) -> str:
    if isinstance(value, dict):
        return "see below" if value else "empty"
    if isinstance(value, bool):
        return str(value).lower()
    return "none" if value is None else str(value).replace("'", "")


if __name__ == "__main__":
    for name in PAGES:
        path = DOCS_FOLDER / name
        path.write_text(page(name, path.read_text("utf-8")), "utf-8")
