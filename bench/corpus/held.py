"""Drums, pyramids and pieces of shells out of a block that the second arm holds and moves.

Feasible by: pieces and cells about as large as those of problems/shell_piece_held; a gripper that is at
least 24 mm inside of the part's bottom on all sides; a block well within the holder's payload.
"""

from __future__ import annotations

import math
from typing import Final

from bench.corpus import cells, foams
from bench.corpus.job import Data, Draft, Draw, Fault


def _ring(draw: Draw, kind: str, rx: float, ry: float, z: float, ripple: float) -> list[list[float]]:
    """A closed guide at a height: an ellipse of many points, or a polygon of ``ripple`` irregularity."""
    if kind == "round":
        count = 72
        return [
            [rx * math.cos(2 * math.pi * k / count), ry * math.sin(2 * math.pi * k / count), z]
            for k in range(count)
        ]
    count = 6 if kind == "hexagon" else 4
    offset = 0.0 if kind == "hexagon" else math.pi / 4
    out = []
    for k in range(count):
        turn = 2 * math.pi * k / count + offset
        scale = (1.0 if kind == "hexagon" else math.sqrt(2.0)) * (1.0 + draw.number(-ripple, ripple, 3))
        out.append([scale * rx * math.cos(turn), scale * ry * math.sin(turn), z])
    return out


def base(draw: Draw) -> Draft:
    """A held piece without fault."""
    small = draw.chance(0.6)
    kind = draw.turn(["round", "hexagon", "square"])
    height = draw.number(140, 200, 0) if small else draw.number(150, 220, 0)
    # half the size of the gripper's face, and of the part's bottom
    if small:
        grip = (draw.pick([90, 100, 120]), draw.pick([90, 100, 120]))
        rx, ry = (draw.number(118, 132, 0) for _ in range(2))
    else:
        grip = (300, 200)
        rx, ry = draw.number(250, 400, 0), draw.number(210, 250, 0)
    if kind == "round" or kind == "hexagon":
        need = math.hypot(grip[0] / 2 + 24, grip[1] / 2 + 24) if kind == "round" else 0.0
        rx, ry = max(rx, need), max(ry, need)
        if kind == "hexagon":
            # the flat sides of a hexagon are 0.866 of its corners away, along y
            ry = max(ry, (grip[1] / 2 + 30) / 0.8)
            rx = max(rx, grip[0] / 2 + 24 + 0.6 * ry)
    grow = draw.number(0.98, 1.12, 2)
    low = _ring(draw, kind, rx, ry, 0.0, 0.02)
    high = _ring(draw, kind, grow * rx, grow * ry, height, 0.03)
    guides: Data = {"start": {"polyline_mm": low}, "end": {"polyline_mm": high}}
    if kind == "round":
        for guide in guides.values():
            guide["corners_mm"] = []
    maximum = [max(abs(p[k]) for p in [*low, *high]) for k in (0, 1)]
    size = [2.0 * math.ceil(maximum[0] + 14), 2.0 * math.ceil(maximum[1] + 14), height]
    robot, span = ("irb140", 400) if small else ("irb4600_40", 650)
    apart = draw.number(690, 720, 0) if small else draw.number(1760, 1820, 0)
    bow = {"kind": "bow", "span_mm": span, "throat_mm": span, "tilt_deg": 45}
    gripper = {"kind": "gripper_plate", "width_mm": grip[0], "depth_mm": grip[1]}
    cell = cells.facing((robot, robot), (bow, gripper), apart, apart, signals=cells.WIRE_SIGNAL)
    problem = {
        "stock": {"size_mm": size, "held_by": "right"},
        "part": {
            "ruled": [{"name": draw.pick(["sides", "drum", "skin"]), "closed": True, **guides}],
            "in_stock": {},
        },
        "operations": [
            {
                "name": "sides",
                "process": "straight_wire",
                "arms": ["left", "right"],
                "shape_tol_mm": draw.pick([0.3, 0.4, 0.5]),
                "step_mm": draw.pick([2.5, 3, 4]) if small else draw.pick([5, 6]),
            }
        ],
    }
    why = f"a {kind} piece around its gripper, of the size that the bundled held pieces have"
    draft = Draft(problem, cell, {}, {"small": small}, why)
    foams.settle(draft, draw, float(span), (1.2, 1.5))
    return draft


def _grip(draft: Draft, draw: Draw) -> None:
    size = draft.problem["stock"]["size_mm"]
    draft.cell["arms"][1]["tool"].update(width_mm=round(1.1 * size[0]), depth_mm=round(0.9 * size[1]))


def _heavy(draft: Draft, draw: Draw) -> None:
    """Over 60 kg of foam with either foam, where the arms carry 6 and 40 kg."""
    draft.problem["stock"]["size_mm"] = [2400, 1600, 800]


def _no_gripper(draft: Draft, draw: Draw) -> None:
    draft.cell["arms"][1]["tool"] = {"kind": "wire_holder", "mounting": "across", "side": "end"}


def _no_foam(draft: Draft, draw: Draw) -> None:
    draft.problem["stock"].pop("foam")


def _corners(draft: Draft, draw: Draw) -> None:
    wall = draft.problem["part"]["ruled"][0]
    x, y, z = (value / 2 - 15 for value in draft.problem["stock"]["size_mm"])
    wall["start"] = {"polyline_mm": [[-x, -y, 0], [x, -y, 0], [0, y, 0]]}
    wall["end"] = {
        "polyline_mm": [[-x, -y, 2 * z + 30], [x, -y, 2 * z + 30], [x, y, 2 * z + 30], [-x, y, 2 * z + 30]]
    }


def _separate_arms(draft: Draft, draw: Draw) -> None:
    for arm, x in zip(draft.cell["arms"], (-4500, 4500), strict=True):
        arm["base"]["xyz_mm"][0] = x


def _let_grip_slip(draft: Draft, draw: Draw) -> None:
    draft.cell["arms"][1]["tool"]["holding_n"] = 0.5


def _two_controllers(draft: Draft, draw: Draw) -> None:
    draft.cell["controller"] = cells.controller(["irb140"] * 2, ["left", "right"], cells.WIRE_SIGNAL, True)


FAULTS: Final = [
    Fault("the gripper's face is larger than the part's bottom", ("stock.footprint",), _grip),
    Fault("the block is heavier than the holder carries", ("stock.too_heavy",), _heavy),
    Fault(
        "the arms are 9 m apart: they do not meet", ("motion.no_reach", "motion.no_placement"), _separate_arms
    ),
    Fault("the arm that is to hold the block has no gripper", ("stock.gripper",), _no_gripper),
    Fault("one guide has three corners, the other one four", ("part.corners",), _corners),
    Fault("the foam of a held block is not named", ("stock.foam_missing",), _no_foam),
    Fault("the gripper holds with half a newton", ("stock.grip_force",), _let_grip_slip),
    foams.TOO_HOT,
    Fault(
        "two controllers that meet by signals share one block", ("post.handshake_process",), _two_controllers
    ),
]
