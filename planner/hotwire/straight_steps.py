"""What the programs say and switch around a job with a straight wire."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from planner import dialogue
from planner.hotwire.straight_cut import Cut
from planner.hotwire.straight_operation import Straight
from planner.hotwire.straight_route import Route
from planner.issues import Issue, Severity
from planner.problem import Setup
from planner.targets import Action
from planner.tooling import Bow
from planner.units import MM

LEVEL: Final = 0.7
"""Least cosine between a cut's normal and the vertical from which what is above it rests on the slot."""


def actions(op: Straight, bow: Bow, setup: Setup, cuts: list[Cut], route: Route) -> tuple[Action, ...]:
    """The operator's steps and the wire's power, by target."""
    diameter, material = 2.0 * bow.radius / MM, f" {op.wire_material}".rstrip()
    if op.power_w is not None:
        mounted = dialogue.BOW_POWER.say(diameter_mm=diameter, material=material, power_w=op.power_w)
    else:
        mounted = dialogue.BOW_SLOT.say(diameter_mm=diameter, material=material, kerf_mm=op.kerf_mm or 0.0)
    last = len(route.segment) - 1
    out = [
        Action(0, "message", mounted),
        Action(0, "confirm", dialogue.TAUT.say()),
        Action(0, "on", signal=op.signal),
        Action(0, "wait", seconds=op.heat_up_s),
    ]
    for number, cut in enumerate(cuts):
        if op.spacers and drops(cut, setup):
            out += _spacers(op, route.ends[number], 2.0 * float(cut.on.half.mean()))
    return (
        *out,
        Action(last, "off", signal=op.signal),
        Action(last, "wait", seconds=op.cool_down_s),
        Action(last, "confirm", dialogue.COLD.say()),
    )


def drops(cut: Cut, setup: Setup) -> bool:
    """Whether what is above an open cut rests on its slot and would drop by a kerf: the slot is level and
    goes through the block, and nothing holds what is above."""
    if cut.wanted.ruled.closed or setup.stock.held_by is not None:
        return False
    normal = cut.on.row.normal.mean(axis=(0, 1))
    return bool(abs(normal @ setup.stock.gravity) > LEVEL * np.linalg.norm(normal))


def check_drops(op: Straight, cuts: list[Cut], setup: Setup) -> Iterator[Issue]:
    """straight.drop where no spacers are asked for and what drops by a kerf is cut later."""
    up = -setup.stock.gravity
    height = [float((cut.on.row.foot.start + cut.on.row.foot.end).mean(axis=0) @ up) for cut in cuts]
    for number, cut in enumerate(cuts):
        later = [k for k in range(number + 1, len(cuts)) if height[k] > height[number]]
        if op.spacers or not later or not drops(cut, setup):
            continue
        slot = 2.0 * float(cut.on.half.mean()) / MM
        yield Issue(
            "straight.drop",
            f"{op.name}: what is above {cut.wanted.segment} drops by the slot of {slot:.1f} mm before "
            f"{cuts[later[0]].wanted.segment} is cut in it; set spacers: true, or cut it later",
            Severity.WARNING,
            field=str(cut.wanted.segment),
            value=slot,
            unit="mm",
            accepted=False,
        )


def _spacers(op: Straight, at: int, kerf: float) -> list[Action]:
    """Off, spacers in, on again: hands come near the wire."""
    return [
        Action(at, "off", signal=op.signal),
        Action(at, "wait", seconds=op.cool_down_s),
        Action(at, "message", dialogue.SPACERS.say(kerf_mm=kerf / MM)),
        Action(at, "confirm", dialogue.SPACED.say()),
        Action(at, "on", signal=op.signal),
        Action(at, "wait", seconds=op.heat_up_s),
    ]
