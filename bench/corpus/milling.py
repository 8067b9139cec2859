"""Milling: flanks of ruled walls, lines over panels and patterns engraved into them, by one arm.

Feasible by: a flute 15 mm longer and an overhang 40 mm longer than the wall is high, guides whose curves are
tens of cutter radii, panels bent by radii of 150 mm and more, stock where the bundled problems have it.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from bench.corpus import cells
from bench.corpus.foams import UNREACHABLE
from bench.corpus.job import Data, Draft, Draw, Fault

STOCK_PLACES: Final = {
    "irb6640_185": ([1500, 0, 900], 0),
    "irb4600_40": ([1300, 0, 800], 0),
    "kr60_ha": ([1300, 0, 700], 90),
}
HOMES: Final = {
    "irb6640_185": [0, -20, 20, 0, 40, 0],
    "irb4600_40": [0, -20, 20, 0, 40, 0],
    "kr60_ha": [0, -110, 110, 0, 40, 0],
}


def mill(cutter: str, diameter: float, flute: float, overhang: float) -> Data:
    return {
        "kind": "mill",
        "cutter": cutter,
        "diameter_mm": diameter,
        "flute_mm": flute,
        "overhang_mm": overhang,
        "holder": [{"length_mm": 50, "diameter_mm": max(30, round(1.8 * diameter))}],
        "spindle_diameter_mm": 100,
        "spindle_length_mm": 240,
        "tilt_deg": 90,
    }


def cell(robot: str, tool: Data) -> Data:
    return cells.alone(robot, tool, HOMES[robot], ("doSpindle",))


def stock(draw: Draw, robot: str, size: list[float]) -> Data:
    """Return a block on a stand that reaches to the floor, completely within the arm's reach."""
    place, yaw = STOCK_PLACES[robot]
    at = [place[0] + draw.pick([-50, 0, 0, 50]), draw.pick([-50, 0, 0, 50]), place[2]]
    pose: Data = {"xyz_mm": at}
    if yaw:
        pose["rpy_deg"] = [0, 0, yaw]
    high = float(at[2] - 20)
    return {"size_mm": size, "place": pose, "support": cells.stand(0.8 * size[0], 0.8 * size[1], high)}


def _problem(draw: Draw, robot: str, size: list[float], part: Data | None, cuts: list[Data]) -> Data:
    operation: Data = {"name": "mill", "process": "milling", "arms": ["robot"], "cuts": cuts}
    operation["feed_mm_s"] = draw.pick([20, 30, 40])
    operation["spindle_rpm"] = draw.pick([12000, 18000])
    problem: Data = {"stock": stock(draw, robot, size)}
    if part is not None:
        problem["part"] = part
    return problem | {"settings": {"clearance_mm": draw.pick([5, 8])}, "operations": [operation]}


def flank(draw: Draw) -> Draft:
    """Twisted walls by the cutter's side."""
    robot = draw.turn(["irb6640_185", "kr60_ha", "irb4600_40"])
    diameter = draw.pick([12, 16, 20])
    height = draw.pick([40, 60, 80, 100])
    length = draw.number(200, 600, 0)
    count = draw.whole(1, 3)
    wave = draw.number(0.01, 0.025, 4) * length
    ruled: list[Data] = []
    for k in range(count):
        y = 100.0 * (k - (count - 1) / 2)
        guides: Data = {}
        for side, z in (("start", 20.0), ("end", 20.0 + height)):
            x = np.linspace(-length / 2, length / 2, 5)
            deviations = [0.0, *(draw.number(-wave, wave) for _ in range(3)), 0.0]
            guides[side] = {"bspline_mm": [[float(u), y + v, z] for u, v in zip(x, deviations, strict=True)]}
        ruled.append({"name": f"wall_{'abc'[k]}", **guides})
    size = [length, 100.0 * count + 20, 20.0 + height]
    cuts: list[Data] = [{"flank": wall["name"]} for wall in ruled]
    if draw.chance(0.5):
        cuts[0]["stepdown_mm"] = height / 2
    if draw.chance(0.4):
        cuts[-1]["direction"] = draw.pick(["climb", "conventional", "against"])
    problem = _problem(draw, robot, size, {"ruled": ruled, "in_stock": {}}, cuts)
    problem["operations"][0] |= {
        "shape_tol_mm": draw.pick([0.15, 0.2, 0.3]),
        "orient": draw.pick(["best", "base"]),
    }
    tool = mill("cylinder", diameter, height + 20.0, height + 55.0)
    why = f"walls of {height} mm, gently twisted, by a cylinder of {diameter} mm that is longer"
    return Draft(problem, cell(robot, tool), {}, {"length": length, "height": height}, why)


def _panel(draw: Draw) -> tuple[Data, list[float]]:
    """A double-curved panel, and the size of its block."""
    radius, half = draw.number(400, 900, 0), draw.number(8, 11, 1)
    width = draw.number(70, 95, 0)
    rises = [draw.number(6, 26), draw.number(6, 26)]
    profiles = [
        {"at": at, "bezier_mm": [[0, -width], [rise, -width / 3], [rise, width / 3], [0, width]]}
        for at, rise in zip((0.0, 1.0), rises, strict=True)
    ]
    chord = 2.0 * radius * np.sin(np.radians(half))
    size = [float(np.ceil(chord + 40)), 2 * width + 40, 80.0]
    return {
        "front": {
            "loft": {"rail": {"radius_mm": radius, "start_deg": -half, "end_deg": half}, "profiles": profiles}
        }
    }, size


def lines(draw: Draw) -> Draft:
    """A panel finished in lines by a ball nose."""
    robot = draw.turn(["irb4600_40", "kr60_ha", "irb6640_185"])
    part, size = _panel(draw)
    diameter = draw.pick([6, 8, 10])
    cut: Data = {"lines": "front", "feed_mm_s": draw.pick([30, 60])}
    cut |= {"scallop_mm": draw.pick([0.1, 0.15])} if draw.chance(0.5) else {"stepover_mm": draw.pick([3, 4])}
    cut |= draw.pick(
        [{}, {"angle_deg": 90}, {"angle_deg": 30}, {"axis": "upright"}, {"lead_deg": 10}, {"zigzag": False}]
    )
    if "stepover_mm" in cut:
        # a ridge between lines is s^2 / 8 R high
        cut["stepover_mm"] = min(cut["stepover_mm"], round(float(np.sqrt(8 * diameter / 2 * 0.12)), 1))
    problem = _problem(draw, robot, size, part | {"in_stock": "auto"}, [cut])
    problem["operations"][0] |= {"shape_tol_mm": draw.pick([0.2, 0.3]), "step_mm": 8}
    tool = mill("ball", diameter, 20, 90)
    return Draft(
        problem, cell(robot, tool), {}, {"size": size}, f"a gentle panel in lines by a ball of {diameter} mm"
    )


def engrave(draw: Draw) -> Draft:
    """Curves engraved into a panel."""
    robot = draw.turn(["kr60_ha", "irb4600_40", "irb6640_185"])
    part, size = _panel(draw)
    x, y = 0.5 * size[0] - 40, 0.5 * size[1] - 40
    curves: list[Data] = []
    for k in range(draw.whole(1, 4)):
        level = -y + 2 * y * (k + 0.5) / 4
        points = [[u, level + draw.number(-12, 12), 0.0] for u in np.linspace(-x, x, 5)]
        curves.append({draw.pick(["bspline_mm", "bezier_mm"]): points})
    cut: Data = {"engrave": curves, "name": "waves", "depth_mm": draw.pick([0.8, 1.5, 2.0])}
    cut |= draw.pick([{}, {"axis": "upright"}, {"lead_deg": 8}, {"tilt_deg": 5}])
    problem = _problem(draw, robot, size, part | {"in_stock": "auto"}, [cut])
    problem["operations"][0]["shape_tol_mm"] = draw.pick([0.15, 0.2])
    tool = mill("ball", draw.pick([4, 6]), 15, 80)
    return Draft(problem, cell(robot, tool), {}, {"size": size}, "curves in the middle of a gentle panel")


def _wall(draft: Draft, low: list[list[float]], high: list[list[float]]) -> None:
    wall = {"name": "wall_a", "start": {"polyline_mm": low}, "end": {"polyline_mm": high}}
    draft.problem["part"] = {"ruled": [wall], "in_stock": {}}
    draft.operation["cuts"] = [{"flank": "wall_a"}]


def _flute(draft: Draft, draw: Draw) -> None:
    draft.cell["arms"][0]["tool"]["flute_mm"] = round(0.5 * draft.facts["height"])


def _inner(draft: Draft, draw: Draw) -> None:
    x, z = 0.4 * draft.facts["length"], 20.0 + draft.facts["height"]
    flat = [[-x, 0.0], [0.0, 30.0], [x, 0.0]]
    _wall(draft, [[*p, 20.0] for p in flat], [[*p, z] for p in flat])


def _tight(draft: Draft, draw: Draw) -> None:
    """A groove of radius 4 mm: the cutter has 6 and more."""
    z = 20.0 + draft.facts["height"]
    turn = np.linspace(-np.pi / 2, np.pi / 2, 37)
    ring = [[float(4 * np.sin(t)), float(4 * np.cos(t))] for t in turn]
    _wall(draft, [[*p, 20.0] for p in ring], [[*p, z] for p in ring])
    draft.operation["cuts"][0]["lead_mm"] = 0


def _twist(draft: Draft, draw: Draw) -> None:
    """Rulings that turn by 90 degrees along 30 mm: a cylinder is far off between its guides."""
    _wall(draft, [[-15, -20, 20], [15, 20, 20]], [[-15, 20, 60], [15, -20, 60]])
    draft.operation["shape_tol_mm"] = 0.02


def _no_mill(draft: Draft, draw: Draw) -> None:
    draft.cell["arms"][0]["tool"] = {"kind": "ball_tool", "radius_mm": 6, "length_mm": 200}


def _surface(draft: Draft, draw: Draw) -> None:
    draft.operation["cuts"][0] = {"flank": "wall_z"}


def _overhang(draft: Draft, draw: Draw) -> None:
    """The nose of the holder below the end of the flute: no such tool can be."""
    tool = draft.cell["arms"][0]["tool"]
    tool["overhang_mm"] = tool["flute_mm"] - 20.0


def _lid(draft: Draft, draw: Draw) -> None:
    """A slab 45 mm above the block, over all of it: the spindle has to be in it."""
    size, place = draft.problem["stock"]["size_mm"], draft.problem["stock"]["place"]["xyz_mm"]
    shape = {
        "kind": "box",
        "size_mm": [1600, 1600, 40],
        "pose": {"xyz_mm": [place[0], place[1], place[2] + size[2] + 65]},
    }
    draft.cell["obstacles"].append({"name": "lid", "shapes": [shape]})


def _thick(draft: Draft, draw: Draw) -> None:
    """A trough under a ball of R 20 whose bottom has a radius of 13 mm: of a cubic (dy/dt)^2 / d2z/dt2 in its
    middle, 63^2 / 300."""
    draft.cell["arms"][0]["tool"] |= {"diameter_mm": 40, "flute_mm": 40, "overhang_mm": 120}
    profile = [[0.0, -40.0], [-50.0, -2.0], [-50.0, 2.0], [0.0, 40.0]]
    sections = [
        {"at": at, "bezier_mm": [[x, y, 60.0 + z] for z, y in profile]}
        for at, x in ((0.0, -80.0), (1.0, 80.0))
    ]
    draft.problem["part"] = {"front": {"loft": {"sections": sections}}, "in_stock": {}}


def _exceed_panel(draft: Draft, draw: Draw) -> None:
    x = 0.5 * draft.facts["size"][0] + 30
    draft.operation["cuts"][0]["engrave"] = [{"polyline_mm": [[-x, 0, 0], [x, 0, 0]]}]


def _small_block(draft: Draft, draw: Draw) -> None:
    draft.problem["stock"]["size_mm"][0] = 90.0


BLOCKED: Final = ("motion.collision", "motion.no_path", "motion.entry")
FLANKS: Final = [
    Fault("the flute is half as long as the wall is high", ("milling.flute",), _flute),
    Fault("an inner corner", ("milling.corner",), _inner),
    UNREACHABLE,
    Fault("a groove narrower than the cutter", ("milling.tool_radius",), _tight),
    Fault("a slab is where the spindle has to be", BLOCKED, _lid),
    Fault("rulings that turn by a right angle", ("milling.twist",), _twist),
    Fault("the flute is longer than what stands out of the holder", ("problem.field",), _overhang),
    Fault("a surface that the part has not", ("milling.no_surface",), _surface),
    Fault("the arm carries no cutter", ("milling.tool",), _no_mill),
]
PANELS: Final = [
    Fault("a trough tighter than the ball", ("milling.tool_radius", "milling.gouge"), _thick),
    UNREACHABLE,
    Fault("the block is shorter than the panel", ("part.stock_too_small",), _small_block),
    Fault("a slab is where the spindle has to be", BLOCKED, _lid),
    Fault("the arm carries no cutter", ("milling.tool",), _no_mill),
]
PATTERNS: Final = [
    Fault("a curve goes beyond the panel", ("milling.off_surface",), _exceed_panel),
    *PANELS[1:],
]


def all_kinds() -> dict[str, Any]:
    """Generators and faults by family."""
    return {"flank": (flank, FLANKS), "lines": (lines, PANELS), "engrave": (engrave, PATTERNS)}
