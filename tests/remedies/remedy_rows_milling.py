"""Rows of ``test_remedies_of_data``: milling and G-code, each a good job with one thing wrong."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from tests.processes.milling.plan.small_mill import BALL, MILL, PANEL, WALL
from tests.refusals import change
from tests.remedies.advice import ReportedFigure, Word, Words
from tests.remedies.remedy_rows import Row, Yaml, lay
from tests.remedies.remedy_rows_parts import ply

CUT: Final = "operations.0.cuts.0."
TOOL: Final = "cell.arms.0.tool."
LINES: Final[Mapping[str, Any]] = {"lines": "front", "stepover_mm": 2.0}
CURVE: Final = [[-30, -15, 0], [0, 15, 0], [30, -15, 0]]
AXIS: Final = [[-30, -15, 60], [0, 15, 60], [30, -15, 60]]
ENGRAVE: Final[Mapping[str, Any]] = {"engrave": [{"bspline_mm": CURVE}], "depth_mm": 0.5}

ALONG: Final = {**ENGRAVE, "engrave": [{"polyline_mm": [[-40, 0, 0], [0, 10, 0], [40, 0, 0]]}]}
"""Along the panel where that lies in its own directions."""


def with_cut(base: dict[str, Any], cut: Mapping[str, Any], tool: Mapping[str, Any] | None = None) -> Any:
    out = copy.deepcopy(base)
    out["stock"]["support"] = "pedestal"
    out["operations"][0]["cuts"] = [dict(cut)]
    out["cell"]["arms"][0]["tool"].update(tool or {})
    return out


def walls(low: list[list[float]], high: list[list[float]], cut: Mapping[str, Any], **tool: Any) -> Any:
    out = with_cut(WALL, {"flank": "wall", **cut}, tool)
    out["part"] = {
        "ruled": [{"name": "wall", "start": {"polyline_mm": low}, "end": {"polyline_mm": high}}],
        "in_stock": {},
    }
    return out


def trough(width: float, deep: float) -> dict[str, Any]:
    """A front with a trough along x, of a cubic like that of the corpus, in a block of 100 mm."""
    out: dict[str, Any] = with_cut(
        PANEL, {**LINES, "stepover_mm": 3}, {**BALL, "diameter_mm": 30, "flute_mm": 40, "overhang_mm": 100}
    )
    profile = [[-width, 28], [-2, 28 - deep], [2, 28 - deep], [width, 28]]
    sections = [{"at": at, "bezier_mm": [[x, *p] for p in profile]} for at, x in ((0.0, -40.0), (1.0, 40.0))]
    out["part"] = {"front": {"loft": {"sections": sections}}, "in_stock": {}}
    return out


def arc(radius: float, high: float) -> list[list[float]]:
    """The corner of 127 degrees at (0, 20) rounded by ``radius``: tangent to both walls, in fine steps."""
    half = math.atan2(20.0, 40.0)  # a wall's slope; the corner turns by twice that
    middle = 20.0 - radius / math.cos(half)
    turn = np.linspace(-half, half, 61)
    ring = [[float(radius * math.sin(t)), float(middle + radius * math.cos(t)), high] for t in turn]
    return [[-40.0, 0.0, high], *ring, [40.0, 0.0, high]]


def hole() -> dict[str, Any]:
    """A conical hole of 40 mm. The retreat would lead through its wall."""
    out: dict[str, Any] = with_cut(WALL, {"flank": "wall"})
    turn = np.linspace(0.0, 2 * np.pi, 240, endpoint=False)
    rings = [
        [[float(r * np.cos(t)), float(r * np.sin(t)), z] for t in turn]
        for r, z in ((20.0, 12.0), (24.0, 50.0))
    ]
    wall = {"name": "wall", "start": {"polyline_mm": rings[0]}, "end": {"polyline_mm": rings[1]}}
    out["part"] = {"ruled": [wall | {"closed": True, "hole": True}], "in_stock": {}}
    return out


def mill(code: str, data: Any, says: str, remedy: Mapping[str, Any]) -> Row:
    return Row(code, lay, data, says, remedy)


def bowl(x: Any, y: Any) -> Any:
    return 2.0 * (x - 0.1) ** 2 + 0.0 * y


def panel(in_stock: Any) -> Any:
    """A front from a mesh file of 200 x 150 mm, so placed in its block."""
    cut = {**LINES, "stepover_mm": 8.0, "shape_tol_mm": 3.0}
    part = {"front": {"mesh": {"file": "m.ply", "unit": "mm"}}, "in_stock": in_stock}
    return change(change(with_cut(PANEL, cut, BALL), "part", part), "stock.size_mm", [300, 200, 300])


FLANK: Final = with_cut(WALL, {"flank": "wall"})
TWISTED: Final = change(
    walls(
        [[-20, -20, 12], [20, 20, 12]],
        [[-20, 20, 50], [20, -20, 50]],
        {},
        diameter_mm=20,
        flute_mm=70,
        overhang_mm=90,
    ),
    "operations.0.shape_tol_mm",
    0.005,
)
HALF: Final = [
    [float(4 * math.sin(t)), float(4 * math.cos(t))] for t in np.linspace(-math.pi / 2, math.pi / 2, 37)
]
GROOVE: Final = walls([[*p, 12.0] for p in HALF], [[*p, 45.0] for p in HALF], {"lead_mm": 0})
FAN: Final = walls([[-8, 0, 12], [8, 0, 12]], [[-30, 0, 50], [30, 0, 50]], {})
BEYOND: Final = {**ENGRAVE, "engrave": [{"polyline_mm": [[0, 0, 0], [90, 0, 0]]}]}
BACKWARD: Final = {**ENGRAVE, "axis": "curves", "axis_curves": [{"bspline_mm": AXIS[::-1]}]}

MILLED: Final = [
    # a trough tighter than the ball, and a groove narrower than the cutter
    mill("milling.tool_radius", trough(25, 26), "use a ball of",
        {f"{TOOL}diameter_mm": ReportedFigure("use a ball of # mm radius", 0.01, down=True, times=2.0)}),
    mill("milling.tool_radius", GROOVE, "the largest radius that fits",
        {f"{TOOL}diameter_mm": ReportedFigure("radius that fits there is # mm", 0.01, down=True, times=2.0)}),
    mill("milling.flute", change(FLANK, f"{TOOL}flute_mm", 17.3), "use a longer flute",
        {f"{TOOL}flute_mm": ReportedFigure("needs # mm of flute", 0.01)}),
    mill("milling.holder", with_cut(WALL, {"flank": "wall", "guides": "tool"}, {"flute_mm": 21.1,
        "overhang_mm": 33.3}), "use an overhang of",
        {f"{TOOL}overhang_mm": ReportedFigure("an overhang of # mm or more", 0.01)}),
    mill("milling.twist", change(TWISTED, "operations.0.shape_tol_mm", 0.1), "Use a radius of",
        {f"{TOOL}diameter_mm": ReportedFigure("radius of # mm or less", 0.01, down=True, times=2.0)}),
    mill("milling.twist", TWISTED, "a shape_tol_mm of",
        {"operations.0.shape_tol_mm": ReportedFigure("a shape_tol_mm of # or more", 0.001)}),
    mill("milling.safe_plane",
        walls([[-40, -20, 30], [40, -20, 30]], [[-40, 20, 31], [40, 20, 31]], {}, flute_mm=60),
        "use safe_side", {"operations.0.safe_side": Word("use safe_side: (\\w+)")}),
    mill("milling.pattern", with_cut(PANEL, {**LINES, "margin_mm": 300}, BALL), "half of its width",
        {f"{CUT}margin_mm": ReportedFigure("# mm would leave", 0.1, down=True)}),
    mill("milling.pattern", with_cut(PANEL, {**LINES, "stepover_mm": 3.3}, BALL), "a stepover_mm of",
        {f"{CUT}stepover_mm": ReportedFigure("a stepover_mm of # or less", 0.01, down=True)}),
    mill("milling.pattern", with_cut(PANEL, {"lines": "front", "scallop_mm": 0.4}, BALL), "a scallop_mm of",
        {f"{CUT}scallop_mm": ReportedFigure("a scallop_mm of # or less", 0.001, down=True)}),
    mill("milling.off_surface", with_cut(PANEL, BEYOND, BALL), "move or shorten it",
        {f"{CUT}engrave.0.polyline_mm.1.0": ReportedFigure("-30.0 to #", 0.1, down=True)}),
    mill("part.stock_too_small", change(with_cut(PANEL, ALONG, BALL), "stock.size_mm", [50, 70, 30]),
        "70, 30] (tried)", {"stock.size_mm": Yaml(r"size_mm: (\[[^]]*\])")}),
    mill("milling.guides", with_cut(PANEL, BACKWARD, BALL), "the same direction",
        {f"{CUT}axis_curves.0.bspline_mm": AXIS}),
    mill("milling.guide_lengths", FAN, "shorten the guide end to", {
        "part.ruled.0.end.polyline_mm.0.0":
            ReportedFigure("shorten the guide end to # mm", down=True, times=-0.5),
        "part.ruled.0.end.polyline_mm.1.0":
            ReportedFigure("shorten the guide end to # mm", down=True, times=0.5)}),
    mill("milling.gouge", hole(), "set a lead_mm",
        {f"{CUT}lead_mm": ReportedFigure("a lead_mm that ends before (#:")}),
    # a tool that leans so far that its holder meets the panel
    mill("milling.gouge", with_cut(PANEL, {**ENGRAVE, "lead_deg": 59}, {**BALL, "overhang_mm": 13,
        "holder": [{"length_mm": 60, "diameter_mm": 60}]}), "(tried)",
        {f"{TOOL}overhang_mm": ReportedFigure("an overhang of # mm or more")}),
    mill("milling.no_surface", change(FLANK, f"{CUT}flank", "door"), "name one of them",
        {f"{CUT}flank": Word("it has (\\w+)")}),
    mill("milling.tool", change(FLANK, "cell.arms.0.tool", {"kind": "bow"}), "a tool of kind mill",
        {"cell.arms.0.tool": {**MILL, "kind": Word("a tool of kind (\\w+)")}}),
    Row("milling.front", lay, panel({"xyz_mm": [-100, -75, 100]}), "flip: true",
        {"part.front.mesh.flip": Yaml("flip: (true)")}, {"m.ply": ply(bowl, 12, is_flipped=True)}),
    Row("milling.front", lay, panel({"xyz_mm": [0, -75, 250], "rpy_deg": [0, 80, 0]}), "in_stock: rpy_deg",
        {"part.in_stock": {"xyz_mm": [-100, -75, 100]}}, {"m.ply": ply(bowl, 12)}),
]  # fmt: skip


# ---- G-code ----------------------------------------

HEAD: Final = "G21 G90 G94 G17 S12000 M3 F1200\n"
TOOL_PATH: Final = "G0 X-30 Y0 Z20\nG1 Z-2\nG1 X30\nG0 Z20\nM30\n"
GOOD: Final = HEAD + TOOL_PATH
FIRST: Final = f"T1 M6\n{GOOD}".replace("M30\n", "")
IJK: Final = HEAD + TOOL_PATH.replace("Z20\nG1 Z-2", "Z20 I0 J0 K1\nG1 Z-2", 1)


def nc(code: str, text: str, says: str, remedy: str | Words | Mapping[str, Any], **stated: Any) -> Row:
    """A file, and the file that is written instead, or fields of ``gcode`` that are stated."""
    gcode = {"file": "a.nc", "origin": {"xyz_mm": [0, 0, 50]}, **stated}
    data = with_cut(WALL, {"gcode": gcode})
    del data["part"]
    if isinstance(remedy, str | Words):
        changes: Mapping[str, Any] = {"@a.nc": remedy}
    else:
        changes = {f"{CUT}gcode.{field}": value for field, value in remedy.items()}
    return Row(code, lay, data, says, changes, {"a.nc": text})


def state(field: str) -> dict[str, Word]:
    """The field with the first of the values that the issue names for it."""
    return {field: Word(rf"state the field {field}: (\w+)")}


def insert_lines(text: str, more: str) -> str:
    """The file with lines before the end of its one cut."""
    return text.replace("G1 X30", f"G1 X0\n{more}\nG1 X30", 1)


def arcs(plane: str, arc_words: str) -> str:
    return HEAD.replace("G17", plane) + TOOL_PATH.replace("G1 X30", f"G2 {arc_words}", 1)


CENTRE: Final = r"that fits is (.*?) mm from"
PROGRAMS: Final = [
    nc("gcode.unit", GOOD.replace("G21 ", ""), "state the field unit", state("unit")),
    nc("gcode.mode", GOOD.replace("G90 ", ""), "state the field distance", state("distance")),
    nc("gcode.mode", GOOD.replace("G0 X-30", "X-30", 1), "state the field motion", state("motion")),
    nc("gcode.mode", GOOD.replace("G1 X30", "/G1 X30\nG1 X20"), "set block_delete", {"block_delete": True}),
    nc("gcode.mode", insert_lines(GOOD, "G4 P1"), "state the field dwell", state("dwell")),
    nc("gcode.mode", insert_lines(GOOD, "G4"), "a P of 0 or above", insert_lines(GOOD, "G4 P1"), dwell="s"),
    nc("gcode.feed", GOOD.replace("G94 ", ""), "state the field feed_mode", state("feed_mode")),
    nc("gcode.feed", GOOD.replace(" F1200", ""), "state feed_mm_min", {"feed_mm_min": 900}),
    nc("gcode.feed", GOOD.replace("F1200", "F-3"), "feed must be positive", GOOD),
    nc("gcode.feed", GOOD.replace("G94", "G93"), "needs its own F",
        GOOD.replace("G94", "G93").replace("Z-2", "Z-2 F20").replace("X30", "X30 F20")),
    nc("gcode.feed", insert_lines(GOOD, "G93 F5 G1 X0\nG94 F1200"), "use G94",
        insert_lines(GOOD, "G94 F5 G1 X0\nF1200")),
    nc("gcode.plane", arcs("G21", "X30 I30 J0"), "state the field plane", state("plane")),
    nc("gcode.spindle", GOOD.replace("M3 ", ""), "write M3 or M4", GOOD),
    nc("gcode.spindle", GOOD.replace("S12000 ", ""), "state spindle_rpm", {"spindle_rpm": 9000}),
    nc("gcode.spindle", GOOD.replace("S12000", "S-2 S12000"), "", GOOD),
    nc("gcode.spindle", insert_lines(GOOD, "S8000"), "retract the tool by G0 before",
        insert_lines(GOOD, "G0 Z20\nS8000\nG0 X0\nG1 Z-2")),
    nc("gcode.rotary", GOOD.replace("G1 X30", "G1 X30 A5"), "and its convention",
        {"tool_axis": Word(r"state tool_axis: (\w+)"), "convention": Word(r"convention: (\w+)")}),
    nc("gcode.rotary", GOOD.replace("G1 X30", "G1 X30 C5"), "state another convention",
        {"convention": Word(r"convention: (\w+)")}, tool_axis="rotary", convention="head_a"),
    nc("gcode.rotary", IJK, "state tool_axis: ijk", {"tool_axis": Word(r"state tool_axis: (\w+)")}),
    nc("gcode.axis", IJK.replace("K1", "K2"), "correct it", IJK, tool_axis="ijk"),
    nc("gcode.axis", insert_lines(IJK, "G1 X1 I1 K0\nG1 X20 I-1\nG1 X21 I0 K1"), "divide the move",
        insert_lines(IJK, "G1 X1 I1 K0\nG1 X10 I0 K1\nG1 X20 I-1 K0\nG1 X21 I0 K1"), tool_axis="ijk"),
    nc("gcode.arc", arcs("G17", "X30 Y8 I24 J-3"), "correct the centre",
        Words(CENTRE, arcs("G17", "X30 Y8 #"))),
    nc("gcode.arc", arcs("G18", "X30 Z-6 I24 K-3"), "correct the centre",
        Words(CENTRE, arcs("G18", "X30 Z-6 #"))),
    nc("gcode.arc", arcs("G17", "X30 Y8 R20"), "give an R of",
        Words(r"an R of (\S+) mm", arcs("G17", "X30 Y8 R#"))),
    nc("gcode.arc", arcs("G17", "X-30 R20"), "give a full circle by I J K", arcs("G17", "X-30 I20 J0")),
    nc("gcode.arc", arcs("G17", "X30 I0 J0"), "correct I J K", arcs("G17", "X30 I30 J0")),
    nc("gcode.position", GOOD.replace("G0 X-30 Y0 Z20\n", ""), "state start_mm", {"start_mm": [-30, 0, 20]}),
    nc("gcode.position", GOOD.replace("G90", "G91"), "state start_mm", {"start_mm": [0, 0, 0]}),
    nc("gcode.position", GOOD.replace("X30", "X30000000"), "correct it", GOOD),
    nc("gcode.position", FIRST + "T2 M6\nM3 G1 X20\nG0 Z20\nM30\n", "start with G0 X Y Z after M6",
        FIRST + "T2 M6\nM3 G0 X30 Y0 Z20\nG1 Z-2\nG1 X20\nG0 Z20\nM30\n",
        tool=2),
    nc("gcode.tool", f"T1 M6\n{HEAD}T2 M6\nM3\n{TOOL_PATH}", "in the field tool",
        {"tool": Yaml(r"tool (\d+) after")}),
    nc("gcode.tool", f"M6\n{GOOD}", "add it", f"T1 M6\n{GOOD}"),
    nc("gcode.tool", f"T1.5 M6\n{GOOD}", "integers from 0", f"T1 M6\n{GOOD}"),
    nc("gcode.offset", f"{HEAD}G55\n{TOOL_PATH}", "add it to offsets", {"offsets": {"G55": [0, 0, 0]}}),
    nc("gcode.empty", HEAD + "G0 X-30 Y0 Z20\nM30\n", "give the G-code of the job", GOOD),
    nc("gcode.empty", f"T1 M6\n{HEAD}M3\n{TOOL_PATH}", "correct the field tool",
        {"tool": Yaml(r"seen in the spindle: (\d+)")}, tool=5),
    nc("gcode.syntax", GOOD.replace("X30", "X30 X20", 1), "keep one", GOOD),
    nc("gcode.syntax", GOOD.replace("Z-2", "Z-2 (down"), "pair ( and )", GOOD.replace("Z-2", "Z-2 (down)")),
    nc("gcode.syntax", GOOD.replace("X30", "X#1", 1), "write plain numbers", GOOD),
    nc("gcode.word", GOOD.replace("G1 X30", "G1 X30 R4"), "remove it", GOOD),
    nc("gcode.word", GOOD.replace("G1 X30", "G0 G1 X30"), "keep one", GOOD),
    nc("gcode.word", insert_lines(GOOD, "M8"), "name it in skip", {"skip": [Word(r"(M8)")]}),
    nc("gcode.word", insert_lines(GOOD, "M0"), "retract the tool by G0 before",
        insert_lines(GOOD, "G0 Z20\nM0\nG0 X0\nG1 Z-2")),
    nc("gcode.word", GOOD.replace("G1 X30", "G4 P1 X30"), "separate them",
        insert_lines(GOOD, "G4 P1"), dwell="s"),
    nc("gcode.after_end", GOOD + "G0 X0\n", "remove it", GOOD),
]  # fmt: skip

ROWS: Final = [*MILLED, *PROGRAMS]
