"""Rule on values about wires that operators are shown, such as the distance of the clamps."""

from collections.abc import Iterator

import numpy as np

from planner.claims.dialogue import OperatorDialogue
from planner.processes.hotwire import sentences as hotwire_sentences
from planner.processes.hotwire.claims import FollowsRulings, WireJoins
from planner.processes.hotwire.proof.rules.straight_wire import guide_deviation, guide_normals
from planner.processes.hotwire.proof.wire_motion import WIRES, WireMotion
from planner.programs.dialogue_text import tolerance
from planner.proof.context import Context
from planner.proof.dialogue import DialoguePosition, expected_dialogue, operator_steps
from planner.proof.findings import Findings
from planner.proof.replay.motion import wire_speed
from planner.proof.rule import RuleOutcome, rule
from planner.proof.rules.dialogue import MatchedStep, compare_dialogue

DIALOGUE_FIGURES = "verify.dialogue_figures"
"""Code of the rule on shown values that follow from the motion."""
CLAMP_DISTANCE_TOLERANCE_M = 0.02e-3
"""Allowed deviation of the clamps from the shown distance [m], in addition to its rounding."""
WIRE_ANGLE_TOLERANCE_DEG = 0.02
"""Allowed deviation of the wire from the shown angle [deg], in addition to its rounding."""
MIN_SIGNED_ANGLE_DEG = 1.0
"""The sign of a shown angle [deg] is not checked if the angle is smaller than this."""
SLOT_TOLERANCE_FRACTION = 0.05
"""Allowed deviation of spacers from the mean slot, as a fraction of the slot, in addition to rounding.

The width of the slot varies with the speed of the wire.
"""


@rule("verify.dialogue_figures", OperatorDialogue)
def message_figures(context: Context) -> RuleOutcome:
    """Figures that the operator is shown and that follow from the motion agree with the motion: distance of
    the clamps of a bent wire, its angles at the clamps, and thickness of spacers.
    """
    wires = context.get(WIRES)
    expected, shown_steps = expected_dialogue(context), operator_steps(context.job)
    findings = Findings(DIALOGUE_FIGURES, context, worst=0.0)
    for task in context.job.tasks:
        matched, _ = compare_dialogue(task, expected[task.name], shown_steps[task.name], expected)
        for step in matched:
            if not step.fit.figures:
                continue
            for name, value, allowed in _motion_figures(context, wires, step):
                shown = float(step.fit.figures[name])
                findings.note_highest(abs(shown - value) / allowed)
                if not abs(shown - value) <= allowed:
                    message = f"{name} is shown as {shown:g}; it follows from the motion as {value:.2f}"
                    findings.add_at_step(message, task, step.entry.step, "plan again")
    if not findings.measured:
        return RuleOutcome(tuple(findings.issues), unit="of rounding", nothing="no such figures")
    return findings.outcome(float, "of rounding", 1.0)


def _motion_figures(
    context: Context, wires: tuple[WireMotion, ...], matched: MatchedStep
) -> Iterator[tuple[str, float, float]]:
    """Yield the name, the value from the motion and the tolerance of each value that a step shows."""
    if matched.step.sentence is hotwire_sentences.CLAMPS:
        yield from _clamp_figures(context, matched)
    elif matched.step.sentence is hotwire_sentences.SPACERS:
        slot = 1e3 * _mean_slot_width(context, wires, matched.position)
        yield "kerf_mm", slot, tolerance(".1f", slot) + SLOT_TOLERANCE_FRACTION * abs(slot)
    else:
        raise ValueError(f"no figures of the motion are known for {matched.step.sentence}")


def _clamp_figures(context: Context, matched: MatchedStep) -> Iterator[tuple[str, float, float]]:
    """Yield the distance of the clamps and the angles of the wire to the line between them, with tolerances.

    An angle is positive if the wire rises there. If the angle is too small, or its plane too level, to tell,
    the shown sign is used.
    """
    name = context.problem.operations[matched.position.operation].name
    claim = next(c for c in context.by_operation[name] if isinstance(c, WireJoins))
    motion = context.motion
    time = next(step_time for step_time, _, _, step in motion.step_time if step is matched.entry.step)
    sample = max(int(np.searchsorted(motion.time, time, side="right")) - 1, 0)
    first, second = (motion.tcp[arm][sample : sample + 1][0] for arm in claim.arms)
    vector = second[:3, 3] - first[:3, 3]
    distance = float(np.linalg.norm(vector))
    yield "apart_mm", 1e3 * distance, tolerance(".1f", 1.0) + 1e3 * CLAMP_DISTANCE_TOLERANCE_M
    direction = vector / max(distance, 1e-12)
    for figure, pose in (("start_deg", first), ("end_deg", second)):
        tangent = pose[:3, 0]
        across = tangent - (tangent @ direction) * direction
        angle = float(np.rad2deg(np.arctan2(np.linalg.norm(across), tangent @ direction)))
        shown = float(matched.fit.figures[figure])
        rise = float(across[2])
        sign = (
            np.sign(shown)
            if abs(angle) < MIN_SIGNED_ANGLE_DEG or abs(rise) < 0.1 * np.linalg.norm(across)
            else np.sign(rise)
        )
        yield figure, float(sign) * angle, tolerance(".1f", 1.0) + WIRE_ANGLE_TOLERANCE_DEG


def _mean_slot_width(context: Context, wires: tuple[WireMotion, ...], position: DialoguePosition) -> float:
    """Return the mean width [m] of the slot along both guide lines of the surface cut at a dialogue position.

    It follows from the speeds of the wire there at all targets. It is NaN if no wire cuts the surface.
    """
    name, motion = context.problem.operations[position.operation].name, context.motion
    key = position.key.removesuffix("_out")
    widths = [np.zeros(0)]
    for claim in context.by_operation[name]:
        if not isinstance(claim, FollowsRulings) or claim.segment.key != key:
            continue
        normals = guide_normals(claim)
        for wire in wires:
            stations = np.flatnonzero((wire.labels == key) & np.isin(wire.sample, motion.node_sample))
            if wire.fault or wire.setup != context.setup_of(claim) or not len(stations):
                continue
            speed = wire_speed(wire.points, motion.time[wire.sample], wire.inside)[stations]
            for guide, normal in zip((claim.start, claim.end), normals, strict=True):
                _, half = guide_deviation(wire.points[stations], speed, guide, normal, claim)
                widths.append(2.0 * half)
    all_widths = np.concatenate(widths)
    return float(all_widths.mean()) if len(all_widths) else float("nan")
