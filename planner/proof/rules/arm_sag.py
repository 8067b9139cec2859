"""verify.sag: loads and stiffness of arms whose sag programs make up for, and how far it moves their tools.

That the arms then stand where they are wanted all other rules see, for places of tools and links are those
of the bent arms (`planner.proof.replay.bending`).
"""

from typing import Final

import numpy as np

from planner.claims.claim import ArmSags
from planner.geometry.arrays import FloatArray
from planner.issues import Issue
from planner.problem import Arm
from planner.proof.context import Context
from planner.proof.kinematics import arm_model
from planner.proof.rule import Outcome, at_sample, mm, rule

SAG: Final = "verify.sag"
FIGURE_ERROR: Final = 1e-9
"""How far figures of claims may be off the problem's, as a share of them or in SI units."""


@rule("verify.sag", ArmSags)
def sag(context: Context) -> Outcome:
    """Arms are taken to bend where the problem has their sag made up for and nowhere else, by the stiffness,
    tools, held blocks and forces that it states, and by no more than it allows."""
    issues: list[Issue] = []
    worst, limit, where = 0.0, 0.0, ""
    for index, setup in enumerate(context.setups):
        for number in setup.operations:
            operation = context.problem.operations[number]
            claimed = [c for c in context.by_operation.get(operation.name, ()) if isinstance(c, ArmSags)]
            for arm in setup.cell.arms:
                own = [claim for claim in claimed if claim.arm == arm.name]
                issues += _figures(context, index, operation.name, arm, own)
            names = {arm.name for arm in setup.cell.arms}
            issues += [
                _wrong(claim.arm, "is no arm of the cell") for claim in claimed if claim.arm not in names
            ]
    for name in () if issues else context.motion.bends:
        for index, setup in enumerate(context.setups):
            most = setup.cell.arm(name).sag
            rows = np.flatnonzero(context.sample_setup == index)
            if most is None or not len(rows):
                continue
            shift = _shift(context, index, name)[rows]
            k = int(np.argmax(shift))
            limit = max(limit, most.most)
            if shift[k] > worst:
                worst, where = float(shift[k]), f"{name} as it stands, off where its controller has it"
            if not shift[k] <= most.most:
                what = f"{name} is bent by {mm(shift[k]):.3f} mm; allowed: {mm(most.most):g} mm"
                measure = (mm(shift[k]), mm(most.most), "mm")
                issues.append(at_sample(SAG, what, context.motion, name, int(rows[k]), measure))
    if not context.motion.bends and not issues:
        return Outcome(nothing="no sag is made up for")
    return Outcome(tuple(issues), mm(worst), mm(limit), "mm", where)


def _shift(context: Context, index: int, arm: str) -> FloatArray:
    """How far (S,) [m] the TCP of an arm is, as it stands, from where its controller has it."""
    setup, motion = context.setups[index], context.motion
    machine = arm_model.machine_of(setup.cell.arm(arm).data)
    tcp = setup.cell.arm(arm).tool.tcp
    out = np.empty(len(motion.time))
    for first in range(0, len(out), 1 << 14):
        some = slice(first, first + (1 << 14))
        counted = (context.based(index)[arm] @ machine.flange(motion.q[arm][some]) @ tcp)[:, :3, 3]
        out[some] = np.linalg.norm(motion.tcp[arm].place[some] - counted, axis=1)
    return out


def _figures(context: Context, index: int, name: str, arm: Arm, own: list[ArmSags]) -> list[Issue]:
    """Where what is claimed of an arm in an operation is not what the problem states."""
    setup, problem = context.setups[index], context.problem
    if arm.sag is None:
        return (
            [_wrong(arm.name, "is taken to bend, whose sag the problem has not made up for")] if own else []
        )
    if len(own) != 1:
        return [_wrong(arm.name, f"has {len(own)} claims of its sag in {name}; wanted is one")]
    claim = own[0]
    stiffness = arm.stiffness or arm.data.stiffness
    if stiffness is None:
        return [_wrong(arm.name, f"has no stiffness that anybody stated, and sag is claimed of it in {name}")]
    mass, moment = 0.0, np.zeros(3)
    if arm.sag.load:
        mass, moment = arm.tool.mass, arm.tool.mass * arm.tool.cog
        held = context.holder(index)
        if held is not None and held.arm == arm.name:
            middle = arm.tool.tcp[:3, :3] @ held.cog + arm.tool.tcp[:3, 3]
            mass, moment = mass + held.mass, moment + held.mass * middle
    stated = [problem.forces.get(i, {}).get(arm.name) for i in setup.operations]
    force = next((one for one in stated if one is not None), None)
    wanted = (
        ("stiffness of the joints [N m/rad]", claim.joints, stiffness.joints),
        ("mass [kg]", claim.mass, mass),
        ("moment of its mass [kg m]", claim.mass * claim.cog, moment),
        ("force of the work [N]", claim.force, np.zeros((1, 3)) if force is None else force.vectors),
        ("height of that force [m]", claim.height, np.zeros(1) if force is None else force.height),
        ("range [m]", claim.most, arm.sag.most),
    )
    out = []
    if claim.frame != (frame := "stock" if force is None else force.frame):
        out.append(
            _wrong(arm.name, f"in {name}: the force is in the frame {claim.frame}, the problem has {frame}")
        )
    for what, got, should in wanted:
        alike = np.shape(got) == np.shape(should)
        if not alike or not np.allclose(got, should, rtol=FIGURE_ERROR, atol=FIGURE_ERROR):
            out.append(_wrong(arm.name, f"in {name}: {what} is {got}, the problem has {should}"))
    return out


def _wrong(arm: str, what: str) -> Issue:
    return Issue(SAG, f"{arm} {what}", arm=arm)
