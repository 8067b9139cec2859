"""G-code files as CAM programs and people write them, in a block on one arm's table.

Feasible by: cuts within the block's top side, at most 8 mm deep, tool axes within 20 degrees of upright, all
modes stated in the file or in the problem; stock where the bundled problem has it.
"""

from __future__ import annotations

import math
from typing import Final

from bench.corpus import milling
from bench.corpus.foams import UNREACHABLE
from bench.corpus.job import Data, Draft, Draw, Fault

HEAD: Final = ["%", "O1000 (PANEL)", "G21 G90 G17 G94 G40 G49 G80", "T1 M6", "S12000 M3", "G0 X0 Y0 Z30"]
TAIL: Final = ["G0 Z30", "M5", "M30", "%"]


def _pocket(draw: Draw) -> list[str]:
    """Parallel lines at a depth."""
    depth, step = draw.number(1, 5), draw.number(6, 10)
    out = [f"G0 X-80 Y-50 Z5 F{draw.pick([1200, 1800, 2400])}", f"G1 Z{-depth} F600", "F1800"]
    y, way = -50.0, 1
    while y <= 50.0:
        out += [f"G1 X{80 * way:g} Y{y:.3f}", f"Y{y + step:.3f}"]
        y, way = y + step, -way
    return out


def _arcs(draw: Draw) -> list[str]:
    """A rounded rectangle with arcs, twice, deeper each time."""
    a, b, r, depth = (
        draw.number(60, 100, 0),
        draw.number(40, 70, 0),
        draw.number(12, 25, 0),
        draw.number(1, 3),
    )
    out = [f"G0 X{-a:g} Y{-b + r:g} Z5"]
    for level in (depth, 2 * depth):
        out += [
            f"G1 Z{-level:g} F500", f"Y{b - r:g} F1800", f"G2 X{-a + r:g} Y{b:g} I{r:g} J0", f"G1 X{a - r:g}",
            f"G2 X{a:g} Y{b - r:g} I0 J{-r:g}", f"G1 Y{-b + r:g}", f"G2 X{a - r:g} Y{-b:g} R{r:g}",
            f"G1 X{-a + r:g}", f"G2 X{-a:g} Y{-b + r:g} I0 J{r:g}",
        ]  # fmt: skip
    return out


def _helix(draw: Draw) -> list[str]:
    """A helix down and a circle at its end."""
    r, depth = draw.number(20, 50, 0), draw.number(2, 6)
    out = [f"G0 X{r:g} Y0 Z5", "G1 Z0 F600"]
    turns = draw.whole(2, 4)
    out += [f"G3 X{r:g} Y0 Z{-depth * (k + 1) / turns:.4f} I{-r:g} J0 F1500" for k in range(turns)]
    return [*out, f"G3 X{r:g} Y0 I{-r:g} J0"]


def _curve(draw: Draw) -> list[str]:
    """Many short moves along a curve, as from a spline."""
    a, depth = draw.number(40, 80, 0), draw.number(1, 4)
    rows = []
    for k in range(181):
        t = math.radians(2 * k)
        rows.append(f"X{a * math.cos(t):.4f} Y{0.7 * a * math.sin(t) * (1 + 0.2 * math.cos(2 * t)):.4f}")
    return [f"G0 {rows[0]} Z5", f"G1 Z{-depth:g} F600", f"G1 {rows[1]} F2000", *rows[2:]]


def _axes(draw: Draw) -> list[str]:
    """A circle with the tool's axis leant outwards, as I J K."""
    r, tilt, depth = draw.number(30, 70, 0), math.radians(draw.number(5, 18, 0)), draw.number(1, 4)
    rows = []
    for k in range(91):
        t = math.radians(4 * k)
        i, j, w = math.sin(tilt) * math.cos(t), math.sin(tilt) * math.sin(t), math.cos(tilt)
        rows.append(f"X{r * math.cos(t):.4f} Y{r * math.sin(t):.4f} Z{-depth:g} I{i:.8f} J{j:.8f} K{w:.8f}")
    high = rows[0].replace(f"Z{-depth:g}", "Z20")
    return [f"G0 {high}", f"G1 {rows[0]} F900", *(f"G1 {row} F2000" for row in rows[1:])]


def _angles(draw: Draw) -> list[str]:
    """Long sides by the angles of a head that turns about Z and X."""
    y, a = draw.number(60, 90, 0), draw.pick([10, 15, 20])
    out = []
    for side, c in ((-1, 0), (1, 180)):
        out += [
            f"G0 X{100 * side:g} Y{side * y:g} Z30 A{a} C{c}",
            "G1 Z-3 F1200",
            f"X{-100 * side:g}",
            "G0 Z30",
        ]
    return [*out, "G0 A0 C0"]


KINDS: Final = (_pocket, _arcs, _helix, _curve, _axes, _angles)


def base(draw: Draw) -> Draft:
    """A G-code job without fault."""
    kind = draw.turn(KINDS)
    robot = draw.pick(["irb6640_185", "kr60_ha", "irb4600_40"])
    diameter = draw.pick([8, 12, 20])
    size = [320.0, 240.0, draw.pick([60.0, 80.0])]
    spec: Data = {"file": "part.nc", "origin": {"xyz_mm": [0, 0, size[2]]}}
    if kind is _axes:
        spec["tool_axis"] = "ijk"
    if kind is _angles:
        spec |= {"tool_axis": "rotary", "convention": "head_ca"}
    head = list(HEAD)
    if draw.chance(0.3) and kind not in (_axes,):
        # what another machine takes as given stands in the problem
        head[2] = "G17 G40 G49 G80"
        spec |= {"unit": "mm", "distance": "absolute", "feed_mode": "per_minute"}
    if kind is _axes:
        head[-1] = "G0 X0 Y0 Z30 I0 J0 K1"
    cut = {"name": "part", "gcode": spec}
    problem = milling._problem(draw, robot, size, None, [cut])
    problem["operations"][0].pop("feed_mm_s")
    problem["operations"][0]["shape_tol_mm"] = draw.pick([0.05, 0.1, 0.2])
    tool = milling.mill("cylinder", diameter, 40, 120)
    text = "\n".join([*head, *kind(draw), *TAIL]) + "\n"
    why = f"G-code:{kind.__name__.replace('_', ' ')}, shallow and within the block's top"
    return Draft(problem, milling.cell(robot, tool), {"part.nc": text.encode()}, {}, why)


def _file(draft: Draft, rows: list[str]) -> None:
    draft.files["part.nc"] = ("\n".join(rows) + "\n").encode()
    spec = draft.operation["cuts"][0]["gcode"]
    draft.operation["cuts"][0]["gcode"] = {"file": spec["file"], "origin": spec["origin"]}


def _lines(*rows: str) -> list[str]:
    return [*HEAD, *rows, *TAIL]


def _spoil(why: str, codes: tuple[str, ...], rows: list[str]) -> Fault:
    def spoil(draft: Draft, draw: Draw) -> None:
        _file(draft, rows)

    return Fault(why, codes, spoil)


FAULTS: Final = [
    _spoil(
        "no unit is stated",
        ("gcode.unit",),
        ["G90 G17 G94", "S12000 M3", "G0 X0 Y0 Z30", "G1 Z-2 F900", "X40", "G0 Z30", "M30"],
    ),
    _spoil("no feed is stated", ("gcode.feed",), _lines("G1 Z-2", "X40")),
    _spoil("an arc whose centre does not fit", ("gcode.arc",), _lines("G1 Z-2 F900", "G2 X10 Y0 I3 J0")),
    _spoil(
        "axes that turn, of a machine that nobody states",
        ("gcode.rotary",),
        _lines("G1 Z-2 F900", "X40 A20 C90"),
    ),
    _spoil("a second tool", ("gcode.tool",), _lines("G1 Z-2 F900", "X40", "G0 Z30", "T2 M6", "G1 Z-2", "X0")),
    _spoil("an origin that nobody places", ("gcode.offset",), _lines("G55", "G1 Z-2 F900", "X40")),
    _spoil(
        "it cuts while the spindle stands",
        ("gcode.spindle",),
        ["G21 G90 G17 G94", "G0 X0 Y0 Z30", "G1 Z-2 F900", "X40", "G0 Z30", "M30"],
    ),
    UNREACHABLE,
    _spoil("a canned cycle", ("gcode.word",), _lines("G81 X20 Y20 Z-5 R2 F300")),
]
