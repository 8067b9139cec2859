"""Cells as users set them up: robots, tools and controllers that fit one another.

Base positions are taken from the ready cells in problems/cells; distances are varied a little.
"""

from __future__ import annotations

from typing import Any, Final

from bench.corpus.job import Data, Draw

HOMES: Final = {
    "irb140": [0, -10, 10, 0, 90, 0],
    "irb1200_7_70": [0, -10, 10, 0, 90, 0],
    "irb4600_40": [0, -20, 20, 0, 90, 0],
    "irb6640_185": [0, -20, 20, 0, 60, 0],
    "irb6700_200": [0, -20, 20, 0, 60, 0],
    "irb4400_60": [0, -20, 10, 0, 40, 0],
    "kr60_ha": [0, -110, 110, 0, 60, 0],
    "kr210_r2700": [0, -110, 110, 0, 60, 0],
}


def floor(z: float = -50.0, size: float = 8000.0) -> Data:
    """The floor, a slab whose top is 50 mm above ``z``."""
    return {
        "name": "floor",
        "shapes": [{"kind": "box", "size_mm": [size, size, 100], "pose": {"xyz_mm": [0, 0, z]}}],
    }


def kuka(robot: str) -> bool:
    return robot.startswith("kr")


def controller(robots: list[str], names: list[str], signals: tuple[str, ...], handshake: bool) -> Data:
    """A MultiMove controller, two that share signals, or those of KUKA arms with numbers of signals."""
    section: Data = {}
    if handshake:
        section["sync"] = "handshake"
    if any(kuka(robot) for robot in robots):
        extra = (
            ("doPartner", "diPartner", "doRunning", "diPartnerRunning", "doMoveEnable") if handshake else ()
        )
        section["dialect"] = "krc4"
        section["io"] = {
            name: {signal: 17 + k for k, signal in enumerate((*signals, *extra))}
            for name, robot in zip(names, robots, strict=True)
            if kuka(robot)
        }
    elif handshake:
        section |= {"tasks": ["T_ROB1"] * 2, "units": ["ROB_1"] * 2}
    else:
        count = range(1, len(robots) + 1)
        section |= {"tasks": [f"T_ROB{k}" for k in count], "units": [f"ROB_{k}" for k in count]}
    return section


def alone(robot: str, tool: Data, home: list[float] | None = None, signals: tuple[str, ...] = ()) -> Data:
    """One arm at the origin."""
    arm = {"name": "robot", "robot": robot, "base": {"xyz_mm": [0, 0, 0]}, "tool": tool}
    arm["home_deg"] = HOMES[robot] if home is None else home
    return {
        "name": f"{robot}_cell",
        "arms": [arm],
        "obstacles": [floor(-60.0)],
        "controller": controller([robot], ["robot"], signals, False),
    }


def facing(
    robots: tuple[str, str],
    tools: tuple[Data, Data],
    left_mm: float,
    right_mm: float,
    homes: tuple[list[float], list[float]] | None = None,
    handshake: bool = False,
    signals: tuple[str, ...] = (),
) -> Data:
    """Return two arms that face each other along x at the given distance from the origin."""
    bases: list[Data] = [
        {"xyz_mm": [-left_mm, 0, 0], "rpy_deg": [0, 0, 0]},
        {"xyz_mm": [right_mm, 0, 0], "rpy_deg": [0, 0, 180]},
    ]
    arms: list[Any] = []
    for k, name in enumerate(("left", "right")):
        home = HOMES[robots[k]] if homes is None else homes[k]
        arms.append({"name": name, "robot": robots[k], "base": bases[k], "tool": tools[k], "home_deg": home})
    return {
        "name": "facing",
        "arms": arms,
        "obstacles": [floor(-60.0)],
        "controller": controller(list(robots), ["left", "right"], signals, handshake),
    }


WIRE_SIGNAL: Final = ("doWirePower",)


def bow_cell(draw: Draw, small: bool) -> tuple[Data, float]:
    """One arm with a bow, and the span of its wire [mm]."""
    if small:
        robot, span = draw.pick(["irb140", "irb140", "irb1200_7_70"]), 400
        tool = {"kind": "bow", "span_mm": span, "throat_mm": 400, "tilt_deg": 45}
    else:
        robot, span = draw.pick(["irb4600_40", "irb4600_40", "irb6640_185", "kr60_ha"]), 650
        tool = {"kind": "bow", "span_mm": span, "throat_mm": 650, "tilt_deg": draw.pick([0, 0, 45])}
    return alone(robot, tool, signals=WIRE_SIGNAL), float(span)


def stand(width: float, depth: float, height: float) -> list[Data]:
    """Return a stand under a lying block, as high as needed; the part below the floor does not matter."""
    return [
        {
            "kind": "box",
            "size_mm": [round(width), round(depth), height],
            "pose": {"xyz_mm": [0, 0, -height / 2]},
        }
    ]


def post(block: list[float], height: float = 800.0) -> list[Data]:
    """A post under a block that was put upright (roll of 90 degrees: its -y is down)."""
    width, deep = 0.45 * block[0], 0.8 * block[2]
    return [
        {
            "kind": "box",
            "size_mm": [round(width), height, round(deep)],
            "pose": {"xyz_mm": [0, -block[1] / 2 - height / 2, block[2] / 2]},
        }
    ]
