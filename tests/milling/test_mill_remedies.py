"""What an issue of milling or of G-code advises is done, by its own figures, and ends it.

Each row breaks a good job, and says which field takes which figure of the message; ``tests/test_remedies.py``
has rows of bundled problems.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner import processes
from planner.geometry.mesh import TriangleMesh
from planner.issues import Issue, Severity, TandemError
from planner.milling import reach
from planner.problem import Mesh
from tests.milling.small_mill import BALL, PANEL, WALL, problem
from tests.refusals import change
from tests.test_remedies import Said, Word

CUT = "operations.0.cuts.0."
TOOL = "cell.arms.0.tool."
LINES: Mapping[str, Any] = {"lines": "front", "stepover_mm": 2.0}
CURVE = [[-30, -15, 0], [0, 15, 0], [30, -15, 0]]
AXIS = [[-30, -15, 60], [0, 15, 60], [30, -15, 60]]
ENGRAVE: Mapping[str, Any] = {"engrave": [{"bspline_mm": CURVE}], "depth_mm": 0.5}


def faults(data: dict[str, Any], folder: Path) -> list[Issue]:
    """Errors of reading the problem and of making its targets."""
    try:
        found = processes.job(problem(folder, data), 0).targets().issues
    except TandemError as error:
        found = tuple(error.issues)
    return [issue for issue in found if issue.severity is Severity.ERROR]


def followed(data: dict[str, Any], remedy: Mapping[str, Any], issues: list[Issue]) -> dict[str, Any]:
    for field, value in remedy.items():
        now: Any = data
        for step in field.split("."):
            now = now[int(step)] if isinstance(now, list) else now.get(step, {})
        data = change(data, field, value.of(issues, now) if isinstance(value, Said | Word) else value)
    return data


def with_cut(base: dict[str, Any], cut: Mapping[str, Any], tool: Mapping[str, Any] | None = None) -> Any:
    out = copy.deepcopy(base)
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
    out = with_cut(PANEL, {**LINES, "stepover_mm": 3}, {**BALL, "diameter_mm": 30, "flute_mm": 40})
    out["cell"]["arms"][0]["tool"]["overhang_mm"] = 100
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
    """A conical hole of 40 mm, of which the way out would lead through its wall."""
    out = with_cut(WALL, {"flank": "wall"})
    turn = np.linspace(0.0, 2 * np.pi, 240, endpoint=False)
    rings = [
        [[float(r * np.cos(t)), float(r * np.sin(t)), z] for t in turn]
        for r, z in ((20.0, 12.0), (24.0, 50.0))
    ]
    wall = {"name": "wall", "start": {"polyline_mm": rings[0]}, "end": {"polyline_mm": rings[1]}}
    out["part"] = {"ruled": [wall | {"closed": True, "hole": True}], "in_stock": {}}
    return out


TWISTED: dict[str, Any] = change(
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
HALF = [[float(4 * math.sin(t)), float(4 * math.cos(t))] for t in np.linspace(-math.pi / 2, math.pi / 2, 37)]

ROWS: dict[str, tuple[str, dict[str, Any], Mapping[str, Any]]] = {
    "a trough tighter than the ball": (
        "milling.tool_radius",
        trough(25, 26),
        {f"{TOOL}diameter_mm": Said("take a ball of # mm radius", 0.01, down=True, times=2.0)},
    ),
    "a groove narrower than the cutter": (
        "milling.tool_radius",
        walls([[*p, 12.0] for p in HALF], [[*p, 45.0] for p in HALF], {"lead_mm": 0}),
        {f"{TOOL}diameter_mm": Said("radius that fits there is # mm", 0.01, down=True, times=2.0)},
    ),
    "a flute shorter than the wall": (
        "milling.flute",
        with_cut(WALL, {"flank": "wall"}, {"flute_mm": 17.3}),
        {f"{TOOL}flute_mm": Said("needs # mm of flute", 0.01)},
    ),
    "a holder below the wall's top": (
        "milling.holder",
        with_cut(WALL, {"flank": "wall"}, {"flute_mm": 21.1, "overhang_mm": 33.3}),
        {
            f"{TOOL}overhang_mm": Said("an overhang of # mm or more", 0.01),
            f"{TOOL}flute_mm": Said("needs # mm of flute", 0.01),
        },
    ),
    "twisted rulings": (
        "milling.twist",
        change(TWISTED, "operations.0.shape_tol_mm", 0.1),
        {f"{TOOL}diameter_mm": Said("radius of # mm or less", 0.01, down=True, times=2.0)},
    ),
    "twisted rulings, within more": (
        "milling.twist",
        TWISTED,
        {"operations.0.shape_tol_mm": Said("a shape_tol_mm of # or more", 0.001)},
    ),
    "a tool that lies flat": (
        "milling.safe_plane",
        walls([[-40, -20, 30], [40, -20, 30]], [[-40, 20, 31], [40, 20, 31]], {}, flute_mm=60),
        {"operations.0.safe_side": Word("take safe_side: (\\w+)")},
    ),
    "a margin wider than the face": (
        "milling.pattern",
        with_cut(PANEL, {**LINES, "margin_mm": 300}, BALL),
        {f"{CUT}margin_mm": Said("# mm would leave", 0.1, down=True)},
    ),
    "ridges of a stepover": (
        "milling.pattern",
        with_cut(PANEL, {**LINES, "stepover_mm": 3.3}, BALL),
        {f"{CUT}stepover_mm": Said("a stepover_mm of # or less", 0.01, down=True)},
    ),
    "ridges of a scallop": (
        "milling.pattern",
        with_cut(PANEL, {"lines": "front", "scallop_mm": 0.4}, BALL),
        {f"{CUT}scallop_mm": Said("a scallop_mm of # or less", 0.001, down=True)},
    ),
    "a curve beyond the panel": (
        "milling.off_surface",
        with_cut(PANEL, {**ENGRAVE, "engrave": [{"polyline_mm": [[0, 0, 0], [90, 0, 0]]}]}, BALL),
        {f"{CUT}engrave.0.polyline_mm.1.0": Said("-30.0 to #", 0.1, down=True)},
    ),
    "an axis curve the other way": (
        "milling.guides",
        with_cut(
            PANEL,
            {**ENGRAVE, "axis": "curves", "axis_curves": [{"bspline_mm": AXIS[::-1]}]},
            BALL,
        ),
        {f"{CUT}axis_curves.0.bspline_mm": AXIS},
    ),
    "a way out through the wall": (
        "milling.gouge",
        hole(),
        {f"{CUT}lead_mm": Said("a lead_mm that ends before (#:")},
    ),
    "a surface that is not there": (
        "milling.no_surface",
        with_cut(WALL, {"flank": "door"}),
        {f"{CUT}flank": Word("it has (\\w+)")},
    ),
}


@pytest.mark.parametrize("row", ROWS)
def test_what_an_issue_of_milling_advises_ends_it(row: str, tmp_path: Path) -> None:
    code, data, remedy = ROWS[row]
    found = faults(data, tmp_path)
    assert code in {issue.code for issue in found}
    left = faults(followed(data, remedy, found), tmp_path)
    assert not [str(issue) for issue in left]


def test_an_inner_corner_is_rounded_as_it_is_said(tmp_path: Path) -> None:
    """How far a circle of radius R stays off a corner that turns by t: R (1 / cos(t / 2) - 1)."""
    low = [[-40.0, 0.0], [0.0, 20.0], [40.0, 0.0]]
    found = faults(walls([[*p, 12.0] for p in low], [[*p, 45.0] for p in low], {}), tmp_path)
    (corner,) = found
    assert corner.code == "milling.corner"
    off = Said("its own, # mm off", 0.01).of(found, None)
    assert off == pytest.approx(6.0 * (math.hypot(20.0, 40.0) / 40.0 - 1.0), abs=0.006)
    radius = Said("by # mm or more", 0.01).of(found, None)
    assert not faults(walls(arc(radius, 12.0), arc(radius, 45.0), {}), tmp_path)
    assert faults(walls(arc(5.0, 12.0), arc(5.0, 45.0), {}), tmp_path)


def test_a_ball_reaches_a_round_trough_of_its_own_radius_alone() -> None:
    """Half a pipe of radius 12 mm, in chords of 0.3 um: a ball of 20 mm that touches its bottom is as deep in
    its rim, 80 degrees up, as its centre is nearer to that than 20 mm; all of the pipe is left."""
    pipe, steep = 12e-3, np.radians(80.0)
    turn = np.linspace(-steep, steep, 181)
    grid = np.array(
        [[[x, pipe * np.sin(t), -pipe * np.cos(t)] for t in turn] for x in np.linspace(0, 5e-3, 6)]
    )
    a, b = np.meshgrid(np.arange(5), np.arange(180), indexing="ij")
    rows = [k.ravel() for k in (a * 181 + b, (a + 1) * 181 + b, (a + 1) * 181 + b + 1, a * 181 + b + 1)]
    faces = np.concatenate(
        [np.stack([rows[0], rows[1], rows[2]], 1), np.stack([rows[0], rows[2], rows[3]], 1)]
    )
    mesh = Mesh(grid.reshape(-1, 3), faces)
    up = TriangleMesh(mesh.vertices, mesh.faces)
    assert float(np.cross(*np.diff(up.vertices[up.faces[0]], axis=0))[2]) > 0.0
    found = reach.left(mesh, 20e-3, 1e-4)
    assert found is not None
    assert found.share == pytest.approx(1.0, abs=0.01)
    # from the one rim the other is in the ball farthest: of the chord that joins them
    across = 2.0 * pipe * np.sin(steep)
    centre = 20e-3 * np.array([-np.sin(steep), np.cos(steep)])
    deepest = 20e-3 - float(np.linalg.norm(np.array([across, 0.0]) * -1.0 - centre))
    assert found.deep == pytest.approx(deepest, rel=0.03)
    assert found.fits is not None and found.fits == pytest.approx(pipe, rel=0.03)
    assert reach.left(mesh, 11.9e-3, 1e-4) is None


HEAD = "G21 G90 G94 G17 S12000 M3 F1200\n"
WAY = "G0 X-30 Y0 Z20\nG1 Z-2\nG1 X30\nG0 Z20\nM30\n"
FILES: dict[str, tuple[str, str, Mapping[str, Any], tuple[str, str]]] = {
    # code, file, fields that are stated, what is written instead in the file
    "unit": ("gcode.unit", (HEAD + WAY).replace("G21 ", ""), {"unit": "mm"}, ("", "")),
    "distance": ("gcode.mode", (HEAD + WAY).replace("G90 ", ""), {"distance": "absolute"}, ("", "")),
    "motion": ("gcode.mode", HEAD + WAY.replace("G0 X-30", "X-30", 1), {"motion": "G0"}, ("", "")),
    "feed mode": ("gcode.feed", (HEAD + WAY).replace("G94 ", ""), {"feed_mode": "per_minute"}, ("", "")),
    "feed": ("gcode.feed", (HEAD + WAY).replace(" F1200", ""), {"feed_mm_min": 900}, ("", "")),
    "no feed": ("gcode.feed", (HEAD + WAY).replace("F1200", "F-3"), {}, ("F-3", "F1200")),
    "plane": (
        "gcode.plane",
        (HEAD + WAY).replace("G17 ", "").replace("G1 X30", "G2 X30 I30 J0"),
        {"plane": "xy"},
        ("", ""),
    ),
    "spindle": ("gcode.spindle", (HEAD + WAY).replace("M3 ", ""), {}, ("S12000", "S12000 M3")),
    "speed": ("gcode.spindle", (HEAD + WAY).replace("S12000 ", ""), {"spindle_rpm": 9000}, ("", "")),
    "switch": (
        "gcode.mode",
        HEAD + WAY.replace("G1 X30", "/G1 X30\nG1 X20"),
        {"block_delete": True},
        ("", ""),
    ),
    "dwell": ("gcode.mode", HEAD + WAY.replace("G1 X30", "G4 P1\nG1 X30"), {"dwell": "s"}, ("", "")),
    "rotary": ("gcode.rotary", HEAD + WAY.replace("G1 X30", "G1 X30 A5"), {}, (" A5", "")),
    "axis": ("gcode.rotary", HEAD + WAY.replace("G1 X30", "G1 X30 I0 J0 K1"), {"tool_axis": "ijk"}, ("", "")),
    "length": (
        "gcode.axis",
        HEAD + WAY.replace("Z20\nG1 Z-2", "Z20 I0 J0 K1\nG1 Z-2 I0 J0 K2", 1),
        {},
        ("K2", "K1"),
    ),
    "place": (
        "gcode.position",
        HEAD + WAY.replace("G0 X-30 Y0 Z20\n", ""),
        {"start_mm": [-30, 0, 20]},
        ("", ""),
    ),
    "far": ("gcode.position", HEAD + WAY.replace("X30", "X30000000"), {}, ("X30000000", "X30")),
    "tool": ("gcode.tool", "T1 M6\n" + HEAD + "T2 M6\nM3\n" + WAY, {}, ("T2 M6\n", "")),
    "no tool": ("gcode.tool", "M6\n" + HEAD + WAY, {}, ("M6", "T1 M6")),
    "origin": ("gcode.offset", HEAD + "G55\n" + WAY, {"offsets": {"G55": [0, 0, 0]}}, ("", "")),
    "empty": ("gcode.empty", HEAD + "G0 X-30 Y0 Z20\nM30\n", {}, ("M30", WAY)),
    "twice": ("gcode.syntax", HEAD + WAY.replace("G1 X30", "G1 X30 X20"), {}, (" X20", "")),
    "no code": ("gcode.word", HEAD + WAY.replace("G1 X30", "G1 X30 R4"), {}, (" R4", "")),
    "both": ("gcode.word", HEAD + WAY.replace("G1 X30", "G0 G1 X30"), {}, ("G0 G1", "G1")),
    "after the end": ("gcode.after_end", HEAD + WAY + "G0 X0\n", {}, ("M30\nG0 X0\n", "M30\n")),
}


def program(text: str, folder: Path, **stated: Any) -> list[Issue]:
    (folder / "a.nc").write_text(text)
    gcode = {"file": "a.nc", "origin": {"xyz_mm": [0, 0, 50]}, **stated}
    data = with_cut(WALL, {"gcode": gcode})
    del data["part"]
    try:
        found = processes.job(problem(folder, data), 0).targets().issues
    except TandemError as error:
        found = tuple(error.issues)
    return [issue for issue in found if issue.code.startswith("gcode.")]


@pytest.mark.parametrize("row", FILES)
def test_what_an_issue_of_a_file_advises_ends_it(row: str, tmp_path: Path) -> None:
    code, text, stated, (before, after) = FILES[row]
    axis = {"tool_axis": "ijk"} if row == "length" else {}
    found = program(text, tmp_path, **axis)
    assert [issue.code for issue in found if issue.code == code], found
    for field in stated:
        assert any(field in issue.message for issue in found), found
    left = program(text.replace(before, after) if before else text, tmp_path, **axis, **stated)
    assert not [str(issue) for issue in left]


@pytest.mark.parametrize("plane", ["G17", "G18"])
def test_an_arc_takes_the_centre_and_the_radius_that_are_named(plane: str, tmp_path: Path) -> None:
    end, other = ("X30 Y8", "J") if plane == "G17" else ("X30 Z-6", "K")
    text = HEAD.replace("G17", plane) + WAY.replace("G1 X30", f"G2 {end} I24 {other}-3")
    found = program(text, tmp_path)
    assert {issue.code for issue in found} == {"gcode.arc"}
    words = Word(r"that fits is (.*?) mm from").of(found, None)
    assert not program(text.replace(f"I24 {other}-3", words), tmp_path)
    text = text.replace(f"I24 {other}-3", "R20")
    found = program(text, tmp_path)
    assert {issue.code for issue in found} == {"gcode.arc"}
    radius = Said("an R of # mm", 0.0001).of(found, None)
    assert not program(text.replace("R20", f"R{radius:.4f}"), tmp_path)
