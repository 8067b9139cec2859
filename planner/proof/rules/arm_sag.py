"""verify.sag: load, stiffness and deflection of arms whose sag is compensated in the programs.

Other rules need no check of the deflected positions: they already use the tool and link poses of the
deflected arms (`planner.proof.replay.arm_deflection`).
"""

from typing import Final

import numpy as np

from planner.claims.claim import ArmSags
from planner.geometry.arrays import FloatArray
from planner.issues import Issue
from planner.problem import Arm
from planner.proof.context import Context
from planner.proof.kinematics import arm_model
from planner.proof.rule import RuleOutcome, mm, rule, sample_issue

SAG: Final = "verify.sag"
"""Code of the rule on the sag of arms."""
FIGURE_TOLERANCE: Final = 1e-9
"""Tolerance between values of claims and of the problem: relative, and absolute in SI units."""


@rule("verify.sag", ArmSags)
def sag(context: Context) -> RuleOutcome:
    """Arms are modelled as elastic exactly where the problem has their sag compensated.
    Stiffness, tools, held blocks and forces are those of the problem, and the deflection stays within
    its limit.
    """
    issues: list[Issue] = []
    worst, limit, where = 0.0, 0.0, ""
    for index, setup in enumerate(context.setups):
        for number in setup.operations:
            operation = context.problem.operations[number]
            claimed = [c for c in context.by_operation.get(operation.name, ()) if isinstance(c, ArmSags)]
            for arm in setup.cell.arms:
                arm_claims = [claim for claim in claimed if claim.arm == arm.name]
                issues += _compare_figures(context, index, operation.name, arm, arm_claims)
            # Claims on arms that are not in the cell.
            names = {arm.name for arm in setup.cell.arms}
            issues += [
                _issue(claim.arm, "is not an arm of the cell") for claim in claimed if claim.arm not in names
            ]
    for name in () if issues else context.motion.loaded_joints:
        for index, setup in enumerate(context.setups):
            compensation = setup.cell.arm(name).sag
            rows = np.flatnonzero(context.sample_setup == index)
            if compensation is None or not len(rows):
                continue
            deflection = _deflection(context, index, name)[rows]
            k = int(np.argmax(deflection))
            limit = max(limit, compensation.max_correction)
            if deflection[k] > worst:
                worst, where = float(deflection[k]), f"deflection of {name} from its controller's pose"
            if not deflection[k] <= compensation.max_correction:
                message = (
                    f"{name} deflects by {mm(deflection[k]):.3f} mm; allowed: "
                    f"{mm(compensation.max_correction):g} mm"
                )
                measure = (mm(deflection[k]), mm(compensation.max_correction), "mm")
                issues.append(sample_issue(SAG, message, context.motion, name, int(rows[k]), measure))
    if not context.motion.loaded_joints and not issues:
        return RuleOutcome(nothing="no sag is compensated")
    return RuleOutcome(tuple(issues), mm(worst), mm(limit), "mm", where)


def _deflection(context: Context, index: int, arm: str) -> FloatArray:
    """Return the distance (S,) [m] at each sample between the deflected arm's TCP and its controller's TCP.

    It is the deflection that verify.sag limits. The base and tool are those of setup ``index``, so only its
    samples are meaningful.
    """
    setup, motion = context.setups[index], context.motion
    machine = arm_model.robot_machine(setup.cell.arm(arm).data)
    tcp = setup.cell.arm(arm).tool.tcp
    out = np.empty(len(motion.time))
    for first in range(0, len(out), 1 << 14):  # batches of 16384 samples limit memory
        rows = slice(first, first + (1 << 14))
        commanded = (context.base_poses(index)[arm] @ machine.flange(motion.q[arm][rows]) @ tcp)[:, :3, 3]
        out[rows] = np.linalg.norm(motion.tcp[arm].position[rows] - commanded, axis=1)
    return out


def _compare_figures(context: Context, index: int, name: str, arm: Arm, claims: list[ArmSags]) -> list[Issue]:
    """Compare the sag claims of an arm in operation ``name`` of setup ``index`` with the problem.

    The arm must have one claim if the problem compensates its sag, else none. Stiffness, mass, moment of the
    mass, force, its height and frame, and the limit of the deflection must agree. One issue is returned per
    value that differs.
    """
    setup, problem = context.setups[index], context.problem
    if arm.sag is None:
        return (
            [_issue(arm.name, "is modelled as elastic, but the problem does not compensate its sag")]
            if claims
            else []
        )
    if len(claims) != 1:
        return [_issue(arm.name, f"has {len(claims)} sag claims in {name}; expected: 1")]
    claim = claims[0]
    stiffness = arm.stiffness or arm.data.stiffness
    if stiffness is None:
        return [_issue(arm.name, f"has a sag claim in {name}, but no stiffness is stated")]
    mass, moment = 0.0, np.zeros(3)
    if arm.sag.load:
        mass, moment = arm.tool.mass, arm.tool.mass * arm.tool.cog
        held = context.stock_holder(index)
        if held is not None and held.arm == arm.name:
            block_centre = arm.tool.tcp[:3, :3] @ held.cog + arm.tool.tcp[:3, 3]
            mass, moment = mass + held.mass, moment + held.mass * block_centre
    stated = [problem.forces.get(i, {}).get(arm.name) for i in setup.operations]
    force = next((stated_force for stated_force in stated if stated_force is not None), None)
    expected = (
        ("stiffness of the joints [N m/rad]", claim.joints, stiffness.joints),
        ("mass [kg]", claim.mass, mass),
        ("moment of its mass [kg m]", claim.mass * claim.cog, moment),
        ("force of the work [N]", claim.force, np.zeros((1, 3)) if force is None else force.vectors),
        ("height of that force [m]", claim.height, np.zeros(1) if force is None else force.height),
        ("range [m]", claim.max_deflection, arm.sag.max_correction),
    )
    out = []
    if claim.frame != (frame := "stock" if force is None else force.frame):
        out.append(
            _issue(arm.name, f"in {name}: the force is in the frame {claim.frame}, the problem has {frame}")
        )
    for quantity, claimed, required in expected:
        same_shape = np.shape(claimed) == np.shape(required)
        if not same_shape or not np.allclose(claimed, required, rtol=FIGURE_TOLERANCE, atol=FIGURE_TOLERANCE):
            out.append(_issue(arm.name, f"in {name}: {quantity} is {claimed}, the problem has {required}"))
    return out


def _issue(arm: str, message: str) -> Issue:
    """Return an issue about an arm. ``message`` continues its name."""
    return Issue(SAG, f"{arm} {message}", arm=arm)
