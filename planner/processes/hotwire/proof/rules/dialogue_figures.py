"""The rule on figures that operators are told about wires."""

from collections.abc import Iterator

import numpy as np

from planner.claims.dialogue import OperatorDialogue
from planner.processes.hotwire import sentences as hotwire_sentences
from planner.processes.hotwire.claims import FollowsRulings, WireJoins
from planner.processes.hotwire.proof.rules.straight_wire import guide_normals, off_guide
from planner.processes.hotwire.proof.wire_motion import WIRES, Wire
from planner.programs.dialogue_text import tolerance
from planner.proof.context import Context
from planner.proof.dialogue import Place, spoken_steps, wanted_dialogue
from planner.proof.findings import Findings
from planner.proof.replay.motion import local
from planner.proof.rule import Outcome, rule
from planner.proof.rules.dialogue import Heard, compare_steps

DIALOGUE_FIGURES = "verify.dialogue_figures"
"""Code of the rule about figures that follow from the motion."""
CLAMP_DISTANCE_ERROR = 0.02e-3
"""How far the clamps may be off the told distance besides its rounding [m]."""
WIRE_ANGLE_ERROR = 0.02
"""How far the wire may be off the told angle besides its rounding [deg]."""
SIGNLESS_ANGLE = 1.0
"""The sign of smaller angles is not looked at [deg]."""
SLOT_SHARE = 0.05
"""Share of the slot by which spacers may be off it besides rounding: its width follows the wire's speed."""


@rule("verify.dialogue_figures", OperatorDialogue)
def message_figures(context: Context) -> Outcome:
    """Figures that the operator is told and that follow from the motion are those of the motion: how far the
    clamps of a bent wire are apart and how it leaves them, how thick spacers are."""
    wires = context.get(WIRES)
    found, said = wanted_dialogue(context), spoken_steps(context.job)
    findings = Findings(DIALOGUE_FIGURES, context, worst=0.0)
    for task in context.job.tasks:
        heard, _ = compare_steps(task, found[task.name], said[task.name], found)
        for one in heard:
            if not one.fit.figures:
                continue
            for name, value, slack in _of_motion(context, wires, one):
                shown = float(one.fit.figures[name])
                findings.highest(abs(shown - value) / slack)
                if not abs(shown - value) <= slack:
                    what = f"{name} is told to be {shown:g}; by the motion it is {value:.2f}"
                    findings.at_step(what, task, one.spoken.step, "plan again")
    if not findings.measured:
        return Outcome(tuple(findings.issues), unit="of rounding", nothing="no such figures")
    return findings.outcome(float, "of rounding", 1.0)


def _of_motion(context: Context, wires: tuple[Wire, ...], heard: Heard) -> Iterator[tuple[str, float, float]]:
    """Names, values and tolerances of the figures of a step, as the motion has them."""
    if heard.step.sentence is hotwire_sentences.CLAMPS:
        yield from _clamps(context, heard)
    elif heard.step.sentence is hotwire_sentences.SPACERS:
        slot = 1e3 * _slot(context, wires, heard.place)
        yield "kerf_mm", slot, tolerance(".1f", slot) + SLOT_SHARE * abs(slot)
    else:
        raise ValueError(f"no figures of the motion are known for {heard.step.sentence}")


def _clamps(context: Context, heard: Heard) -> Iterator[tuple[str, float, float]]:
    """Distance of the clamps and angles of the wire to the line between them, positive where it rises."""
    name = context.problem.operations[heard.place.operation].name
    claim = next(c for c in context.by_operation[name] if isinstance(c, WireJoins))
    motion = context.motion
    time = next(at for at, _, _, step in motion.step_time if step is heard.spoken.step)
    row = max(int(np.searchsorted(motion.time, time, side="right")) - 1, 0)
    first, second = (motion.tcp[arm][row : row + 1][0] for arm in claim.arms)
    way = second[:3, 3] - first[:3, 3]
    apart = float(np.linalg.norm(way))
    yield "apart_mm", 1e3 * apart, tolerance(".1f", 1.0) + 1e3 * CLAMP_DISTANCE_ERROR
    along = way / max(apart, 1e-12)
    for figure, pose in (("start_deg", first), ("end_deg", second)):
        tangent = pose[:3, 0]
        across = tangent - (tangent @ along) * along
        angle = float(np.rad2deg(np.arctan2(np.linalg.norm(across), tangent @ along)))
        told = float(heard.fit.figures[figure])
        up = float(across[2])
        sign = (
            np.sign(told)
            if abs(angle) < SIGNLESS_ANGLE or abs(up) < 0.1 * np.linalg.norm(across)
            else np.sign(up)
        )
        yield figure, float(sign) * angle, tolerance(".1f", 1.0) + WIRE_ANGLE_ERROR


def _slot(context: Context, wires: tuple[Wire, ...], place: Place) -> float:
    """The mean width [m] of the slot that a cut has left along both guide lines of its surface, by the wire's
    speeds there at all targets."""
    name, motion = context.problem.operations[place.operation].name, context.motion
    key = place.key.removesuffix("_out")
    widths = [np.zeros(0)]
    for claim in context.by_operation[name]:
        if not isinstance(claim, FollowsRulings) or claim.segment.key != key:
            continue
        normals = guide_normals(claim)
        for wire in wires:
            rows = np.flatnonzero((wire.labels == key) & np.isin(wire.sample, motion.node_sample))
            if wire.fault or wire.setup != context.setup_of(claim) or not len(rows):
                continue
            speed = local(wire.points, motion.time[wire.sample], wire.inside)[rows]
            for guide, normal in zip((claim.start, claim.end), normals, strict=True):
                _, half = off_guide(wire.points[rows], speed, guide, normal, claim)
                widths.append(2.0 * half)
    every = np.concatenate(widths)
    return float(every.mean()) if len(every) else float("nan")
