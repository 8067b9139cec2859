"""Ruled walls: front and back of a block that lies on a stand, by a bow on one arm.

Feasible by: curves far flatter than half a slot, walls at least 22 mm apart and 10 mm off the block's faces,
both guides of about the same length.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from bench.corpus import cells, foams
from bench.corpus.job import Data, Draft, Draw, Fault

NAMES: Final = [("front", "back"), ("wall", "wall_in"), ("outer", "inner"), ("a", "b")]


def _guide(draw: Draw, x: float, length: float, level: float, rise: float, kind: str) -> Data:
    """A guide across the block at ``x``: a curve about a level along y, off it by ``rise`` at most."""
    count = draw.pick([4, 5])
    ys = np.linspace(-length / 2, length / 2, count)
    if kind == "polyline":
        ys = np.linspace(-length / 2, length / 2, 61)
        phase, waves = draw.number(0, 3.1, 2), draw.pick([0.5, 1, 1.5])
        zs = level + rise * np.sin(phase + 2 * math.pi * waves * ys / length)
    else:
        zs = level + np.array([draw.number(-rise, rise) for _ in ys])
    points = [[x, float(y), float(z)] for y, z in zip(ys, zs, strict=True)]
    if kind == "polyline":
        return {"polyline_mm": points, "corner_deg": 20}
    return {f"{kind}_mm": points}


def base(draw: Draw) -> Draft:
    """A wall without fault."""
    small = draw.chance(0.5)
    cell, wire = cells.bow_cell(draw, small)
    width = draw.number(200, 290, 0) if small else draw.number(300, 480, 0)
    length = draw.number(260, 420, 0) if small else draw.number(400, 700, 0)
    thick = draw.number(26, 50, 0)
    rise = draw.number(3, 12)
    height = math.ceil(thick + 4 * rise + 24)
    low = 12 + 2 * rise / 2
    names = draw.turn(NAMES)
    kind = draw.turn(["bspline", "polyline", "bezier"])
    kinds = (kind, kind)
    ruled: list[Data] = []
    for name, level in zip(names, (low + thick + rise, low), strict=True):
        half = rise / 2
        wall: Data = {
            "name": name,
            "start": _guide(draw, -width / 2, length, level, half, kinds[0]),
            "end": _guide(draw, width / 2, length, level, half, kinds[1]),
        }
        if name == names[0]:
            wall["flip"] = True
        ruled.append(wall)
    one = draw.chance(0.3)
    size = [width, length, float(height)]
    problem = {
        "stock": {"size_mm": size, "place": "auto", "support": cells.stand(0.4 * width, 0.6 * length, 1500)},
        "part": {"ruled": ruled[:1] if one else ruled, "in_stock": {}},
        "operations": [
            {
                "name": "walls",
                "process": "straight_wire",
                "arms": ["robot"],
                "shape_tol_mm": draw.pick([0.3, 0.4, 0.5]),
                "cuts": [{"surface": name} for name in names[: 1 if one else 2]],
            }
        ],
    }
    draft = Draft(
        problem,
        cell,
        {},
        {"names": names},
        "two flat ruled walls, far from one another and the block's faces",
    )
    foams.settle(draft, draw, wire)
    return draft


def _wall(draft: Draft) -> Any:
    return draft.problem["part"]["ruled"][0]


def _span(draft: Draft, draw: Draw) -> None:
    wide = draft.facts["wire"] + draw.number(5, 60, 0)
    for wall in draft.problem["part"]["ruled"]:
        for side, x in (("start", -wide / 2), ("end", wide / 2)):
            for points in wall[side].values():
                if isinstance(points, list):
                    for point in points:
                        point[0] = x
    draft.problem["stock"]["size_mm"][0] = wide


def _corners(draft: Draft, draw: Draw) -> None:
    """One guide with a corner, the other one without."""
    wall, length = _wall(draft), draft.problem["stock"]["size_mm"][1]
    for side, bend in (("start", 30.0), ("end", 0.0)):
        x = next(p for p in wall[side].values() if isinstance(p, list))[0][0]
        wall[side] = {"polyline_mm": [[x, -length / 2, 40], [x, 0, 40 + 5 * bend], [x, length / 2, 40]]}
    draft.problem["stock"]["size_mm"][2] = 240


def _above(draft: Draft, draw: Draw) -> None:
    draft.problem["stock"]["size_mm"][2] = 24.0


def _missing(draft: Draft, draw: Draw) -> None:
    draft.operation["cuts"][0]["surface"] = "outline"


def _narrow(draft: Draft, draw: Draw) -> None:
    """Two parts with 0.4 mm between them, where the slot is 1.2 mm wide and more: the one's is in the
    other."""
    size = draft.problem["stock"]["size_mm"]
    half, x = size[1] / 2, size[0] / 2
    ruled = []
    for name, z, flip in ((draft.facts["names"][0], 40.4, False), (draft.facts["names"][1], 40.0, True)):
        guides = {s: {"polyline_mm": [[u, -half, z], [u, half, z]]} for s, u in (("start", -x), ("end", x))}
        ruled.append({"name": name, **guides, **({"flip": True} if flip else {})})
    draft.problem["part"]["ruled"] = ruled
    draft.operation["cuts"] = "all"
    size[2] = 80


def _few(draft: Draft, draw: Draw) -> None:
    _wall(draft)["start"] = {"polyline_mm": [[0, 0, 30]]}


FAULTS: Final = [
    Fault("the wall is wider than the bow's wire with its margins", ("bow.span",), _span),
    foams.TOO_HOT,
    Fault("one guide has a corner, the other has none", ("part.corners",), _corners),
    foams.UNREACHABLE,
    Fault("the walls stand out of the block", ("part.stock_too_small",), _above),
    Fault(
        "the walls are nearer to each other than a slot is wide",
        ("straight.crossing", "straight.corner", "straight.lead"),
        _narrow,
    ),
    Fault("a surface that the part has not", ("part.missing_surface",), _missing),
    Fault("a guide of one point", ("problem.field", "part.guide"), _few),
]
