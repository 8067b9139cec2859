"""Writes tables from the code: fields of problem and batch files, and the rules of the proof, into ``docs/``.

Run ``python docs/make_reference.py`` after a change of a schema; a test compares the file with what this
writes.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from planner import (
    cell_file,
    controller_file,
    part_faces_file,
    part_file,
    part_plate_file,
    part_ruled_file,
    part_sheet_file,
    part_surface_file,
    part_wing_file,
    posed,
    problem_file,
    sheet_file,
    stock_file,
)
from planner.batch import batch_file
from planner.forming import operation as forming
from planner.hotwire import operation, straight_operation
from planner.milling import gcode_file
from planner.milling import operation as milling
from planner.verify import prove

HERE = Path(__file__).parent
START, END = "<!-- written by make_reference.py -->", "<!-- end of what make_reference.py writes -->"

CHAPTERS: tuple[tuple[str, str, type[BaseModel]], ...] = (
    ("The whole file", "", problem_file.ProblemFile),
    ("`stock`", "", stock_file.StockFile),
    ("`setup` of an operation", "setup", stock_file.SetupFile),
    ("`foam` of `stock`, a file", "", stock_file.FoamReference),
    ("`sheet`", "", sheet_file.SheetFile),
    ("`sheet.clamp`", "", sheet_file.ClampFile),
    ("`settings`", "", problem_file.SettingsFile),
    ("`part`", "", part_file.PartFile),
    ("`part.front`", "", part_faces_file.FrontFile),
    ("`part.front.loft`, `part.strips.loft`", "", part_faces_file.LoftFile),
    ("`part.front.loft.rail`", "", part_faces_file.RailFile),
    ("`part.front.loft.profiles` and `sections`, each", "", part_faces_file.CurveFile),
    ("`part.front.loft.region`", "", part_faces_file.RegionFile),
    ("`part.front.mesh`, `part.back.mesh`, `part.strips.mesh`", "", part_faces_file.FaceMeshFile),
    ("`part.back`", "", part_faces_file.BackFile),
    ("`part.ruled`, each", "", part_ruled_file.RuledFile),
    ("`start` and `end` of `part.ruled`", "", part_ruled_file.GuideFile),
    ("`dxf` of a guide", "", part_ruled_file.DxfFile),
    ("`part.wing`", "", part_wing_file.WingFile),
    ("`root` and `tip` of `part.wing`", "", part_wing_file.SectionFile),
    ("`part.plate`", "", part_plate_file.PlateFile),
    ("`part.plate.outlines`, each", "", part_plate_file.OutlineFile),
    ("`circle` of an outline", "", part_plate_file.CircleFile),
    ("`part.plate.dxf`", "", part_plate_file.PlateDxfFile),
    ("`part.mesh`", "", part_surface_file.RuledMeshFile),
    ("`part.strips`", "", part_surface_file.StripsFile),
    ("`part.sheet_mesh`", "", part_sheet_file.SheetMeshFile),
    ("`part.in_stock`", "", part_file.PlaceFile),
    ("Process `elastic_wire`", "elastic_wire", operation.ElasticWire),
    ("`wire` of `elastic_wire`", "", operation.WireFile),
    ("Process `straight_wire`", "straight_wire", straight_operation.Straight),
    ("`cuts` of `straight_wire`: a surface", "", straight_operation.SurfaceCut),
    ("`cuts` of `straight_wire`: sides of the block", "", straight_operation.TrimCut),
    ("Process `forming`", "forming", forming.Forming),
    ("`adsif` of `forming`", "", forming.Adsif),
    ("`die` of `forming`", "", forming.Die),
    ("Process `milling`", "milling", milling.Milling),
    ("`cuts` of `milling`: a flank", "", milling.FlankCut),
    ("`cuts` of `milling`: lines", "", milling.LinesCut),
    ("`cuts` of `milling`: an engraving", "", milling.EngraveCut),
    ("`cuts` of `milling`: a G-code file", "", gcode_file.GCodeCut),
    ("`gcode` of such a cut", "", gcode_file.GCodeFile),
    ("Process `targets`", "process-targets", posed.Posed),
    ("`free` of `targets`, each", "", posed.FreeAxis),
    ("`cell`, or the file that it names", "cell", cell_file.CellFile),
    ("`cell.arms`, each", "", cell_file.ArmFile),
    ("Tool `wire_holder`", "", cell_file.WireHolderFile),
    ("Tool `bow`", "", cell_file.BowFile),
    ("Tool `gripper_plate`", "", cell_file.GripperPlateFile),
    ("Tool `vacuum_cup`", "", cell_file.VacuumCupFile),
    ("Tool `ball_tool`", "", cell_file.BallToolFile),
    ("Tool `disk_tool`", "", cell_file.DiskToolFile),
    ("Tool `heat_tool`", "", cell_file.HeatToolFile),
    ("Tool `mill`", "", cell_file.MillFile),
    ("`holder` of `mill`, each", "", cell_file.HolderPieceFile),
    ("Tool `plain`", "", cell_file.PlainToolFile),
    ("`cell.obstacles`, each", "", cell_file.ObstacleFile),
    ("`cell.wires`, each", "", cell_file.WiresFile),
    ("`cell.controller`", "", controller_file.ControllerFile),
    ("`cell.controller.interlock`", "", controller_file.InterlockFile),
    ("`outputs` of `interlock`, by request", "", controller_file.PowerOutputFile),
    ("`places` of `interlock`, by arm and signal", "", controller_file.DevicePlaceFile),
    ("`cell.controller.handshake`", "", controller_file.HandshakeFile),
    ("`signals` of `handshake`, by arm", "", controller_file.SignalsFile),
    ("`wires` of `handshake`, each", "", controller_file.SignalWireFile),
    ("`output` and `input` of a wire", "", controller_file.WireEndFile),
    ("Shape `box`", "", cell_file.BoxFile),
    ("Shapes `cylinder` and `capsule`", "", cell_file.RoundFile),
    ("Shape `sphere`", "", cell_file.SphereFile),
    ("Shape `mesh`", "", cell_file.MeshFile),
    ("A pose", "", cell_file.PoseFile),
)


def fields() -> str:
    """The tables of all chapters as Markdown."""
    return "\n".join(_chapter(title, anchor, model) for title, anchor, model in CHAPTERS)


def rules() -> str:
    """The table of the proof's rules."""
    rows = [f"| `{code}` | {title} |" for code, title in prove.TITLES.items()]
    return "\n".join(["| rule | what it asks |", "|---|---|", *rows, ""])


def batch_fields() -> str:
    """The tables of a batch file."""
    return "\n".join([_table(batch_file.BatchFile), "A range of `vary`:", "", _table(batch_file.RangeFile)])


PAGES: dict[str, Callable[[], str]] = {
    "problem_file.md": fields,
    "proof.md": rules,
    "batch.md": batch_fields,
}


def page(name: str, old: str) -> str:
    """The page with its tables replaced."""
    before, rest = old.split(START)
    _, after = rest.split(END)
    return f"{before}{START}\n\n{PAGES[name]()}\n{END}{after}"


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
        path = HERE / name
        path.write_text(page(name, path.read_text("utf-8")), "utf-8")
