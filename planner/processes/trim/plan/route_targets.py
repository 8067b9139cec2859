"""From the route of a tool to targets: poses, freedoms, feeds, switched outputs and operator messages."""

from typing import Final

import numpy as np

from planner.claims.claim import Claim
from planner.geometry.arrays import FloatArray, from_parts
from planner.geometry.corner_rounding import ROTATION_LEVER_MM
from planner.geometry.units import DEG, MM
from planner.problem import Setup
from planner.processes.forming.plan.job import tool_poses
from planner.processes.trim import sentences as trim_sentences
from planner.processes.trim.plan.claims import operator_figures
from planner.processes.trim.plan.cutting import CuttingTool, TrimTool, mounted_tool
from planner.processes.trim.plan.exhibits import SlotTargets, exhibits
from planner.processes.trim.plan.feed_check import max_stop_time, mean_feed_fractions
from planner.processes.trim.plan.operation import KnifeCut, MillCut, Trim
from planner.processes.trim.plan.route import TRIM, TrimRoute
from planner.processes.trim.plan.slots import SlotPlan
from planner.processes.trim.plan.stretches import heading_vectors
from planner.targets import CornerRounding, ScrewFreedom, TargetAction, Targets

ROUNDED_FRACTION: Final = 0.25
"""Fraction of the tolerance that rounded corners may use."""
AIR_LEVER_M: Final = 0.05
"""Distance behind the TCP [m] of the point whose speed counts in the air, where the tool rotates."""
ROUNDED_ROTATION_FRACTION: Final = 0.1
"""Fraction of the allowed angle between blade and curve that rounded corners may use."""
SPIN_TOLERANCE_M: Final = 5e-4
"""Allowed displacement [m] due to the spin of the tool, at the lever of its rotation."""


def build_targets(
    op: Trim,
    setup: Setup,
    tool: CuttingTool,
    slot_plan: SlotPlan,
    route: TrimRoute,
    claims: tuple[Claim, ...],
) -> Targets:
    """Build the targets of a trim operation.

    Args:
        op: Operation.
        setup: Cell and stock as the operation finds them.
        tool: How the tool of the arm cuts.
        slot_plan: Outlines on the face, and their slots in order.
        route: Route through the slots.
        claims: Claims of the job.

    Raises:
        TandemError: ``trim.tool`` if the tool of the arm does not cut as the operation states.
    """
    arm, count = op.arms[0], len(route.segment)
    arm_tool = mounted_tool(op, setup.cell.arm(arm).tool)
    actions = _build_actions(op, setup, arm_tool, tool, route)
    stop = route.stop.copy()  # the arm stops at each target with an action
    stop[[action.target for action in actions]] = True
    return Targets(
        arms=op.arms,
        pose={arm: _tcp_poses(route, tool)},
        frame={arm: "stock"},
        freedoms=_freedoms(arm, route.max_tilt, tool),
        feed=mean_feed_fractions(stop, tool) * route.feed,
        feed_min=np.zeros(count),
        travel=_travel_lengths(route, tool),
        stop=stop,
        segment=route.segment,
        actions=actions,
        claims=claims,
        exhibits=exhibits(
            op, arm_tool, tool, slot_plan.slots, slot_plan.outlines, slot_targets=_slot_targets(route)
        ),
        rounding=_corner_rounding(op, arm, tool),
        may_stop=tool.blade is None,  # with other stops, moves of a knife next to them would be too fast
        may_join=True,
    )


def _slot_targets(route: TrimRoute) -> list[SlotTargets]:
    """Return the targets of each slot of a route."""
    slot_slices = [slice(a, b + 1) for a, b in zip(route.start_rows, route.end_rows, strict=True)]
    return [
        SlotTargets(route.tip[targets], route.axis[targets], route.height[targets]) for targets in slot_slices
    ]


def _tcp_poses(route: TrimRoute, tool: CuttingTool) -> FloatArray:
    """Return poses (N, 4, 4) of the TCP; x of a knife is its cutting direction."""
    if tool.blade is None:
        return tool_poses(route.tip, -route.axis)
    x, z = heading_vectors(route.axis, route.heading), -route.axis
    return from_parts(np.stack([x, np.cross(z, x), z], axis=-1), route.tip)


def _freedoms(arm: str, max_tilt: FloatArray, tool: CuttingTool) -> tuple[ScrewFreedom, ...]:
    """Return the freedoms of the tool: spin, and tilts about x and y by at most ``max_tilt`` (N,) [rad].

    Tilts rotate about the point of the face that is cut, which is behind the TCP by the depth. A knife spins
    by at most ``max_tilt`` and does not tilt.
    """
    out, depth = [], tool.depth
    spin = {arm: np.eye(6)[2]}
    if tool.blade is not None:
        return (ScrewFreedom(f"spin_{arm}", spin, -max_tilt, max_tilt),)
    # a rotation w about a point p of the TCP frame displaces its origin by -w x p
    for name, k, displacement in (("tilt_x", 0, [0.0, -depth, 0.0]), ("tilt_y", 1, [depth, 0.0, 0.0])):
        bound = max_tilt / np.sqrt(2.0)  # half side of the square within the circle
        twist = np.concatenate([np.eye(3)[k], displacement])
        out.append(ScrewFreedom(f"{name}_{arm}", {arm: twist}, -bound, bound))
    half_turn = np.full(len(max_tilt), np.pi)
    return (*out, ScrewFreedom(f"spin_{arm}", spin, -half_turn, half_turn, None, True))


def _corner_rounding(op: Trim, arm: str, tool: CuttingTool) -> CornerRounding:
    """Return how far corners may be rounded: by a fraction of the tolerances.

    Rotations about the tool's axes count as deviations by levers [m/rad]. A torch or a cutter may spin
    more freely, a knife by a fraction of the allowed angle between blade and curve.
    """
    deviation = min(CornerRounding.work, ROUNDED_FRACTION * min(op.shape_tol_mm, op.height_tol_mm) * MM)
    spin_lever = ROTATION_LEVER_MM * MM * deviation / SPIN_TOLERANCE_M
    if tool.blade is not None and isinstance(op.by, KnifeCut):
        spin_lever = max(tool.blade.width, deviation / (ROUNDED_ROTATION_FRACTION * op.by.heading_deg * DEG))
    levers = {arm: np.array([ROTATION_LEVER_MM * MM, ROTATION_LEVER_MM * MM, spin_lever])}
    return CornerRounding(deviation, deviation, min(CornerRounding.air, deviation), levers)


def _travel_lengths(route: TrimRoute, tool: CuttingTool) -> FloatArray:
    """Return the distance (N,) [m] that the TCP moves to each target, to which the feed applies.

    In the air, where the tool rotates, it is at least that of a point behind the TCP, and for a knife also
    that of a point ahead of it.
    """
    out = np.zeros(len(route.tip))
    out[1:] = np.linalg.norm(np.diff(route.tip, axis=0), axis=1)
    ends = [route.tip + AIR_LEVER_M * route.axis]
    if tool.blade is not None:
        ends.append(route.tip + AIR_LEVER_M * heading_vectors(route.axis, route.heading))
    lever_lengths = np.max([np.linalg.norm(np.diff(end, axis=0), axis=1) for end in ends], axis=0)
    in_air = np.array([s.kind != TRIM or s.phase != "" for s in route.segment[1:]])
    out[1:] = np.where(in_air, np.maximum(out[1:], lever_lengths), out[1:])
    return out


def _build_actions(
    op: Trim, setup: Setup, arm_tool: TrimTool, tool: CuttingTool, route: TrimRoute
) -> tuple[TargetAction, ...]:
    """Return the actions at targets: messages, questions, and switching of arc, spindle or drive.

    At the first target the operator is informed and asked whether the tool is ready, at the last one whether
    it is off. A spindle or drive runs from the first to the last target. An arc is switched on at the start
    of each slot and off at its end.
    """
    last = len(route.segment) - 1
    message_values = operator_figures(op, setup, arm_tool)
    if isinstance(op.by, MillCut):
        tool_message = TargetAction(0, "message", trim_sentences.TRIM_MILL.format(**message_values))
        ready_question = TargetAction(0, "confirm", trim_sentences.TRIM_MILL_READY.format())
        final_question = TargetAction(last, "confirm", trim_sentences.TRIM_MILL_STOPPED.format())
        return (
            tool_message,
            ready_question,
            *_switch_actions(op, last, op.by.spin_up_s, op.by.spin_down_s),
            final_question,
        )
    if isinstance(op.by, KnifeCut):
        tool_message = TargetAction(0, "message", trim_sentences.TRIM_KNIFE.format(**message_values))
        ready_question = TargetAction(0, "confirm", trim_sentences.TRIM_KNIFE_READY.format())
        final_question = TargetAction(last, "confirm", trim_sentences.TRIM_KNIFE_DONE.format())
        return (
            tool_message,
            ready_question,
            *_switch_actions(op, last, op.by.start_up_s, op.by.run_down_s),
            final_question,
        )
    out = [
        TargetAction(0, "message", trim_sentences.TORCH.format(**message_values)),
        TargetAction(0, "message", trim_sentences.TORCH_STOPPED.format()),
        TargetAction(0, "confirm", trim_sentences.TORCH_READY.format()),
    ]
    stop_time = max_stop_time(op, tool.kerf)
    for first, end in zip(route.start_rows, route.end_rows, strict=True):
        out.append(TargetAction(first, "on", signal=op.signal or "", max_dwell=stop_time))
        if op.ok_signal is not None:
            out.append(TargetAction(first, "input", signal=op.ok_signal, seconds=op.ok_timeout_s))
        if op.pierce.seconds > 0.0:
            out.append(TargetAction(first, "wait", seconds=op.pierce.seconds))
        out.append(TargetAction(end, "off", signal=op.signal or ""))
    return (*out, TargetAction(last, "confirm", trim_sentences.TORCH_COLD.format()))


def _switch_actions(op: Trim, last: int, spin_up: float, spin_down: float) -> tuple[TargetAction, ...]:
    """Return the actions of an output, if there is one, that is on from the first to the ``last`` target."""
    if op.signal is None:
        return ()
    return (
        TargetAction(0, "on", signal=op.signal),
        TargetAction(0, "wait", seconds=spin_up),
        TargetAction(last, "off", signal=op.signal),
        TargetAction(last, "wait", seconds=spin_down),
    )
