"""From the way of a tool to targets: its poses, what each leaves open, how fast, and what is switched and
asked on the way."""

from typing import Any, Final

import numpy as np

from planner.claims.claim import Claim
from planner.geometry.arrays import FloatArray, from_parts
from planner.geometry.corner_rounding import TURNING_LEVER_MM
from planner.geometry.units import DEG, MM
from planner.problem import Setup
from planner.processes.forming.plan.job import poses
from planner.processes.trim import sentences as trim_sentences
from planner.processes.trim.plan.claims import told
from planner.processes.trim.plan.cutting import Cutting, Trimmer
from planner.processes.trim.plan.operation import KnifeCut, MillCut, Trim
from planner.processes.trim.plan.pace import shares, stands
from planner.processes.trim.plan.route import TRIM, Route
from planner.processes.trim.plan.shown import Way, exhibits
from planner.processes.trim.plan.slots import Slot, Wanted
from planner.processes.trim.plan.stretches import ahead
from planner.targets import Action, Rounding, ScrewFreedom, Targets

ROUNDED_SHARE: Final = 0.25
"""Share of the tolerance that rounded corners may take."""
AIR_LEVER: Final = 0.05
"""A point so far [m] behind the TCP counts for the speed in the air, where the torch turns."""
ROUNDED_TURN_SHARE: Final = 0.1
"""Share of it that rounded corners may take;"""
SPIN_WAY: Final = 5e-4
"""How far [m] what spins with the torch may be off, at the lever of its turning."""


def targets_of(
    op: Trim,
    setup: Setup,
    mounted_tool: Trimmer,
    tool: Cutting,
    made: list[Slot],
    wanted: tuple[Wanted, ...],
    route: Route,
    stated: tuple[Claim, ...],
    sheet: dict[str, Any],
) -> Targets:
    arm, count = op.arms[0], len(route.segment)
    actions = _actions(op, setup, mounted_tool, tool, route)
    stop = route.stop.copy()
    stop[[action.at for action in actions]] = True
    return Targets(
        arms=op.arms,
        pose={arm: _poses(route, tool)},
        frame={arm: "stock"},
        freedoms=_freedoms(arm, route.lean, tool),
        feed=shares(stop, tool) * route.feed,
        feed_min=np.zeros(count),
        travel=_travel(route, tool),
        stop=stop,
        segment=route.segment,
        actions=actions,
        claims=stated,
        exhibits=exhibits(op, mounted_tool, tool, made, wanted, _ways(route)) | sheet,
        rounding=_rounding(op, arm, tool),
        may_stop=tool.blade is None,  # the moves beside other stops would be too fast in between
        may_join=True,
    )


def _ways(route: Route) -> list[Way]:
    rows = [slice(a, b + 1) for a, b in zip(route.pierce, route.end, strict=True)]
    return [Way(route.tip[own], route.axis[own], route.height[own]) for own in rows]


def _poses(route: Route, tool: Cutting) -> FloatArray:
    """Poses (N, 4, 4) of the TCP; x of a knife is the way it cuts."""
    if tool.blade is None:
        return poses(route.tip, -route.axis)
    x, z = ahead(route.axis, route.heading), -route.axis
    return from_parts(np.stack([x, np.cross(z, x), z], axis=-1), route.tip)


def _freedoms(arm: str, lean: FloatArray, tool: Cutting) -> tuple[ScrewFreedom, ...]:
    """Spin of the tool, and leans about x and y within the circle of ``lean`` (N,) [rad]; all turn about the
    place of the face that is cut, as deep behind the TCP. A knife spins as far as that, and does not lean."""
    out, deep, spin = [], tool.deep, {arm: np.eye(6)[2]}
    if tool.blade is not None:
        return (ScrewFreedom(f"spin_{arm}", spin, -lean, lean),)
    # a turn w about a place p of the TCP's frame moves its origin by -w x p
    for name, k, moved in (("tilt_x", 0, [0.0, -deep, 0.0]), ("tilt_y", 1, [deep, 0.0, 0.0])):
        bound = lean / np.sqrt(2.0)
        twist = np.concatenate([np.eye(3)[k], moved])
        out.append(ScrewFreedom(f"{name}_{arm}", {arm: twist}, -bound, bound))
    turn = np.full(len(lean), np.pi)
    return (*out, ScrewFreedom(f"spin_{arm}", spin, -turn, turn, None, True))


def _rounding(op: Trim, arm: str, tool: Cutting) -> Rounding:
    """Corners take a share of what the cut edge may be off. A torch or a cutter may spin as it likes, a knife
    by a share of what it may stand off its curve."""
    work = min(Rounding.work, ROUNDED_SHARE * min(op.shape_tol_mm, op.height_tol_mm) * MM)
    spin = TURNING_LEVER_MM * MM * work / SPIN_WAY
    if tool.blade is not None and isinstance(op.by, KnifeCut):
        spin = max(tool.blade.width, work / (ROUNDED_TURN_SHARE * op.by.heading_deg * DEG))
    levers = {arm: np.array([TURNING_LEVER_MM * MM, TURNING_LEVER_MM * MM, spin])}
    return Rounding(work, work, min(Rounding.air, work), levers)


def _travel(route: Route, tool: Cutting) -> FloatArray:
    """Way (N,) [m] of the TCP on the move to each target; in the air that of a point behind it, where
    longer, and of a knife of one before it."""
    out = np.zeros(len(route.tip))
    out[1:] = np.linalg.norm(np.diff(route.tip, axis=0), axis=1)
    ends = [route.tip + AIR_LEVER * route.axis]
    if tool.blade is not None:
        ends.append(route.tip + AIR_LEVER * ahead(route.axis, route.heading))
    far = np.max([np.linalg.norm(np.diff(end, axis=0), axis=1) for end in ends], axis=0)
    air = np.array([s.kind != TRIM or s.phase != "" for s in route.segment[1:]])
    out[1:] = np.where(air, np.maximum(out[1:], far), out[1:])
    return out


def _actions(
    op: Trim, setup: Setup, mounted_tool: Trimmer, tool: Cutting, route: Route
) -> tuple[Action, ...]:
    """What the operator is told and asked, and the arc, or the spindle."""
    last, figures = len(route.segment) - 1, told(op, setup, mounted_tool)
    if isinstance(op.by, MillCut):
        tell = Action(0, "message", trim_sentences.TRIM_MILL.filled(**figures))
        ask = Action(0, "confirm", trim_sentences.TRIM_MILL_READY.filled())
        asked = Action(last, "confirm", trim_sentences.TRIM_MILL_STANDS.filled())
        return tell, ask, *_switched(op, last, op.by.spin_up_s, op.by.spin_down_s), asked
    if isinstance(op.by, KnifeCut):
        tell = Action(0, "message", trim_sentences.TRIM_KNIFE.filled(**figures))
        ask = Action(0, "confirm", trim_sentences.TRIM_KNIFE_READY.filled())
        asked = Action(last, "confirm", trim_sentences.TRIM_KNIFE_DONE.filled())
        return tell, ask, *_switched(op, last, op.by.start_up_s, op.by.run_down_s), asked
    out = [
        Action(0, "message", trim_sentences.TORCH.filled(**figures)),
        Action(0, "message", trim_sentences.TORCH_STOPPED.filled()),
        Action(0, "confirm", trim_sentences.TORCH_READY.filled()),
    ]
    stay = stands(op, tool.kerf)
    for first, end in zip(route.pierce, route.end, strict=True):
        out.append(Action(first, "on", signal=op.signal or "", stands=stay))
        if op.ok_signal is not None:
            out.append(Action(first, "input", signal=op.ok_signal, seconds=op.ok_timeout_s))
        if op.pierce.seconds > 0.0:
            out.append(Action(first, "wait", seconds=op.pierce.seconds))
        out.append(Action(end, "off", signal=op.signal or ""))
    return (*out, Action(last, "confirm", trim_sentences.TORCH_COLD.filled()))


def _switched(op: Trim, last: int, up: float, down: float) -> tuple[Action, ...]:
    """What is switched all the while, if anything is: on at the first target, off at the ``last`` one."""
    if op.signal is None:
        return ()
    return (
        Action(0, "on", signal=op.signal),
        Action(0, "wait", seconds=up),
        Action(last, "off", signal=op.signal),
        Action(last, "wait", seconds=down),
    )
