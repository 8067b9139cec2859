"""Plates: outlines with acute, square and round corners and holes, drawn in DXF or given as points.

Feasible by: pieces and holes at least 12 mm apart, 15 mm of foam around, holes larger than 24 mm, inner
corners of at least 55 degrees, round ones of at least 4 mm: all more than a slot of 1.6 mm needs.
"""

from __future__ import annotations

import itertools
import math
from typing import Any, Final

from bench.corpus import cells, foams
from bench.corpus.job import Draft, Draw, Fault

Point = tuple[float, float]


def _polar(radius: float, degrees: float) -> Point:
    return radius * math.cos(math.radians(degrees)), radius * math.sin(math.radians(degrees))


def triangle(size: float, draw: Draw) -> list[Point]:
    """A triangle with an acute corner of 30 to 45 degrees."""
    angle = math.radians(draw.number(30, 45))
    return [
        (-size, -0.45 * size),
        (size, -0.45 * size),
        (size, -0.45 * size + 2 * size * math.tan(angle) * 0.6),
    ]


def star(size: float, draw: Draw) -> list[Point]:
    """A star with inner corners."""
    count, inner = draw.whole(4, 6), draw.number(0.55, 0.65, 2)
    return [_polar(size * (1.0 if k % 2 == 0 else inner), 180.0 * k / count) for k in range(2 * count)]


def ell(size: float, draw: Draw) -> list[Point]:
    """An L of square corners."""
    arm = draw.number(0.35, 0.5, 2) * size
    return [
        (-size, -size),
        (size, -size),
        (size, -size + arm),
        (-size + arm, -size + arm),
        (-size + arm, size),
        (-size, size),
    ]


def tab(size: float, draw: Draw) -> list[Point]:
    """A square whose upper side has a square tab and whose right one has a slot for it."""
    w, h = 0.3 * size, 0.25 * size
    return [
        (-size, -size), (size, -size), (size, -w), (size - h, -w), (size - h, w), (size, w), (size, size),
        (w, size), (w, size + h), (-w, size + h), (-w, size), (-size, size),
    ]  # fmt: skip


def dovetail(size: float, draw: Draw) -> list[Point]:
    """A square with a dovetail whose inner corners are acute, 60 to 75 degrees."""
    w, h = 0.25 * size, 0.3 * size
    out = w + h / math.tan(math.radians(draw.number(60, 75)))
    return [
        (-size, -size),
        (size, -size),
        (size, size),
        (w, size),
        (out, size + h),
        (-out, size + h),
        (-w, size),
        (-size, size),
    ]


def rounded_square(size: float, draw: Draw) -> list[Point]:
    """A square whose corners are round."""
    radius = draw.number(0.15, 0.5, 2) * size
    out = []
    for turn, (sx, sy) in zip((0, 90, 180, 270), ((1, 1), (-1, 1), (-1, -1), (1, -1)), strict=True):
        for step in range(9):
            x, y = _polar(radius, turn + 90.0 * step / 8)
            out.append((sx * (size - radius) + x, sy * (size - radius) + y))
    return out


def octagon(size: float, draw: Draw) -> list[Point]:
    return [_polar(size, 45.0 * k + 22.5) for k in range(8)]


SHAPES: Final = (triangle, star, ell, tab, dovetail, rounded_square, octagon)
CIRCLE_HOLE, SQUARE_HOLE, SLOT_HOLE = "circle", "square", "slot"


def _hole(kind: str, size: float, at: Point) -> Any:
    if kind == CIRCLE_HOLE:
        return at, size
    width = size if kind == SQUARE_HOLE else 1.5 * size
    high = size if kind == SQUARE_HOLE else 0.7 * size
    return [(at[0] + sx * width, at[1] + sy * high) for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))]


def dxf(curves: list[Any], layer: str) -> bytes:
    """A drawing (DXF, R12) of closed polygons, as single lines, and circles (centre, radius)."""
    rows: list[Any] = [0, "SECTION", 2, "ENTITIES"]
    for curve in curves:
        if isinstance(curve, tuple):
            (x, y), radius = curve
            rows += [0, "CIRCLE", 8, layer, 10, f"{x:.4f}", 20, f"{y:.4f}", 30, 0.0, 40, f"{radius:.4f}"]
            continue
        for (x0, y0), (x1, y1) in zip(curve, [*curve[1:], curve[0]], strict=True):
            rows += [0, "LINE", 8, layer, 10, f"{x0:.4f}", 20, f"{y0:.4f}", 30, 0.0]
            rows += [11, f"{x1:.4f}", 21, f"{y1:.4f}", 31, 0.0]
    rows += [0, "ENDSEC", 0, "EOF"]
    return "".join(f"{row}\n" for row in rows).encode()


def _bounds(curves: list[Any]) -> tuple[float, float]:
    """Width and height of what outer polygons and circles take."""
    xs, ys = [], []
    for curve in curves:
        points = [(p[0], p[1]) for p in curve] if not isinstance(curve, tuple) else []
        if isinstance(curve, tuple):
            (x, y), radius = curve
            points = [(x - radius, y - radius), (x + radius, y + radius)]
        xs += [p[0] for p in points]
        ys += [p[1] for p in points]
    return max(xs) - min(xs), max(ys) - min(ys)


def _spec(curve: Any) -> dict[str, Any]:
    if isinstance(curve, tuple):
        return {"circle": {"centre_mm": list(curve[0]), "radius_mm": curve[1]}}
    return {"polyline_mm": [list(point) for point in curve]}


def base(draw: Draw) -> Draft:
    """A plate without fault."""
    small = draw.chance(0.6)
    cell, wire = cells.bow_cell(draw, small)
    size = draw.number(55, 80, 0) if small else draw.number(80, 120, 0)
    shape = SHAPES[draw.index % len(SHAPES)]
    curves: list[Any] = [shape(size, draw)]
    if shape is not triangle and shape is not star and draw.chance(0.6):
        at = (-0.45 * size, -0.45 * size) if shape is ell else (0.0, 0.0)
        hole = min(draw.number(0.22, 0.3, 2) * size, 0.1 * size if shape is ell else size)
        if hole >= 12.0:
            curves.append(_hole(draw.pick([CIRCLE_HOLE, SQUARE_HOLE, SLOT_HOLE]), hole, at))
    if small is False and draw.chance(0.5):
        width, _ = _bounds(curves)
        curves += [[(x + width + 14.0, y) for x, y in octagon(0.5 * size, draw)]]
    width, height = _bounds(curves)
    thick = draw.pick([40, 50, 60, 80, 100])
    block = [round(width + draw.pick([30, 40, 60])), round(height + draw.pick([30, 40, 60])), thick]
    part: dict[str, Any]
    files = {}
    unit, scale = draw.pick([("mm", 1.0), ("mm", 1.0), ("cm", 0.1), ("m", 0.001)])
    if draw.chance(0.5):
        scaled = [
            (tuple(scale * v for v in c[0]), scale * c[1])
            if isinstance(c, tuple)
            else [(scale * x, scale * y) for x, y in c]
            for c in curves
        ]
        unit = "mm" if scale == 0.001 else unit  # four digits of a metre would be too coarse a drawing
        files["plate.dxf"] = dxf(curves if scale == 0.001 else scaled, "cut")
        part = {"plate": {"dxf": {"file": "plate.dxf", "unit": unit, "layer": "cut"}}}
    else:
        part = {"plate": {"outlines": [_spec(curve) for curve in curves]}}
    problem = {
        "stock": {"size_mm": block, "place": "auto", "roll_pitch_deg": [90, 0], "support": cells.post(block)},
        "part": part,
        "operations": [
            {
                "name": "plate",
                "process": "straight_wire",
                "arms": ["robot"],
                "shape_tol_mm": draw.pick([0.3, 0.3, 0.5]),
            }
        ],
    }
    why = f"{shape.__name__}, {len(curves)} outlines: corners, gaps and holes are larger than the slot needs"
    draft = Draft(problem, cell, files, {"curves": curves, "size": size}, why)
    foams.settle(draft, draw, wire)
    return draft


def _points(draft: Draft, curves: list[Any]) -> None:
    draft.files.pop("plate.dxf", None)
    draft.problem["part"] = {"plate": {"outlines": [_spec(curve) for curve in curves]}}


def _bow_tie(draft: Draft, draw: Draw) -> None:
    s = 0.8 * draft.facts["size"]
    _points(draft, [[(-s, -s), (s, s), (s, -s), (-s, s)]])


def _open(draft: Draft, draw: Draw) -> None:
    s = 0.8 * draft.facts["size"]
    lines = [(-s, -s), (s, -s), (s, s), (-s, s)]
    rows: list[Any] = [0, "SECTION", 2, "ENTITIES"]
    for (x0, y0), (x1, y1) in itertools.pairwise(lines):
        rows += [0, "LINE", 8, "cut", 10, x0, 20, y0, 11, x1, 21, y1]
    draft.files["plate.dxf"] = "".join(f"{row}\n" for row in [*rows, 0, "ENDSEC", 0, "EOF"]).encode()
    draft.problem["part"] = {"plate": {"dxf": {"file": "plate.dxf", "unit": "mm", "layer": "cut"}}}


def _overlap(draft: Draft, draw: Draw) -> None:
    s = draft.facts["size"]
    _points(
        draft,
        [
            [(x - 0.3 * s, y) for x, y in octagon(0.5 * s, draw)],
            [(x + 0.3 * s, y) for x, y in octagon(0.5 * s, draw)],
        ],
    )


def _twice(draft: Draft, draw: Draw) -> None:
    one = octagon(0.6 * draft.facts["size"], draw)
    _points(draft, [one, one])


def _narrow(draft: Draft, draw: Draw) -> None:
    """Two squares at a distance of 0.6 mm, where the slot is at least 1.2 mm wide."""
    s = 0.45 * draft.facts["size"]
    square = [(-s, -s), (s, -s), (s, s), (-s, s)]
    _points(draft, [[(x - s - 0.3, y) for x, y in square], [(x + s + 0.3, y) for x, y in square]])


def _pin_hole(draft: Draft, draw: Draw) -> None:
    _points(draft, [octagon(0.8 * draft.facts["size"], draw), ((0.0, 0.0), 0.35)])


def _wide(draft: Draft, draw: Draw) -> None:
    size = draft.problem["stock"]["size_mm"]
    size[0] = round(0.6 * size[0])


def _thick(draft: Draft, draw: Draw) -> None:
    size = draft.problem["stock"]["size_mm"]
    size[2] = round(draft.facts["wire"] - 10)
    draft.problem["stock"]["support"] = cells.post(size)


def _layer(draft: Draft, draw: Draw) -> None:
    s = 0.8 * draft.facts["size"]
    draft.files["plate.dxf"] = dxf([[(-s, -s), (s, -s), (s, s), (-s, s)]], "cut")
    draft.problem["part"] = {"plate": {"dxf": {"file": "plate.dxf", "unit": "mm", "layer": "CUT_1"}}}


def _deep(draft: Draft, draw: Draw) -> None:
    """A hole in the middle of a plate that is wider than twice the throat."""
    side = 2.0 * draft.facts["wire"] + 250.0
    half = side / 2 - 20
    _points(
        draft,
        [
            [(-half, -half), (half, -half), (half, half), (-half, half)],
            [(-40, -40), (40, -40), (40, 40), (-40, 40)],
        ],
    )
    draft.problem["stock"].update(size_mm=[side, side, 60], support=cells.post([side, side, 60]))


FAULTS: Final = [
    Fault("an outline crosses itself", ("part.outline_crossing",), _bow_tie),
    Fault(
        "two pieces are nearer to one another than the slot is wide",
        ("straight.crossing", "straight.corner", "straight.lead"),
        _narrow,
    ),
    Fault("the drawing's outline is not closed", ("part.outline_open",), _open),
    Fault("the outlines are wider than the block", ("part.stock_too_small",), _wide),
    foams.TOO_HOT,
    Fault("two outlines lie over each other", ("part.outline_overlap",), _overlap),
    Fault("a hole is smaller than the slot", ("straight.corner",), _pin_hole),
    Fault("the block is thicker than the bow's wire with its margins", ("bow.span",), _thick),
    Fault("an outline is given twice", ("part.outline_duplicate",), _twice),
    foams.UNREACHABLE,
    Fault("the drawing has no such layer", ("part.dxf",), _layer),
    Fault("a hole is deeper in the plate than the bow's throat on every side", ("bow.throat",), _deep),
    foams.TOO_COLD,
]
