"""The rule on configuration data of RAPID targets."""

from collections.abc import Iterator

import numpy as np

from planner.issues import Issue
from planner.languages.rapid.reader.program_text import RapidText
from planner.programs.stages import TaskText
from planner.programs.steps import MoveStep, RobTarget
from planner.proof.context import Context
from planner.proof.kinematics import arm_model
from planner.proof.rule import RuleOutcome, node_issue, rule, step_issue
from planner.proof.rules.robot_motion import MAX_JOINT_STEP_RAD, straight_nodes


@rule("verify.confdata")
def confdata(context: Context) -> RuleOutcome:
    """RAPID: confdata alone select the joint solution at each target (all 0 for offset wrists)."""
    motion = context.motion
    issues: list[Issue] = []
    worst = 0.0
    for task in context.job.tasks:
        arm = task.arm.name
        if not isinstance(task.text, RapidText):
            continue  # verify.status covers KRL; movel (URScript) keeps the posture that movej has reached
        # has_unnamed_postures: arms with parallel rods or an offset wrist. No source states how confdata
        # number their postures. Such arms run with ConfL\Off, so their confdata select nothing, and the check
        # below does not apply. is_followed: the arm has an offset wrist, and all its confdata must be 0.
        # Arms with parallel rods need no zeros, because the quadrants of their single axes are still valid.
        if task.arm.data.has_unnamed_postures:
            if arm_model.robot_machine(task.arm.data).is_followed:
                issues += list(_nonzero_confdata(task))
            continue
        # All arrays have one row per node k of the motion (K), the target at which move k ends.
        # selected: joints (K, 6) [rad] that confdata alone select. They are NaN if no solution has these
        # confdata, or if a target of the run of straight moves has none.
        # joint_values: joints (K, 6) [rad] of the replayed motion there.
        # Only straight moves are checked. Joint moves are MoveAbsJ, which state joints and no confdata.
        selected = motion.node_conf_q[arm]
        joint_values = motion.q[arm][motion.node_sample]
        straight = straight_nodes(context, arm)
        no_solution = straight & ~np.isfinite(selected).all(axis=1)
        # deviation (K,) [rad]: that of the axis that differs most. Another solution differs by more than
        # MAX_JOINT_STEP_RAD. A target without solution has the deviation 0, because no_solution reports it.
        deviation = np.abs(np.where(np.isfinite(selected), selected, joint_values) - joint_values).max(axis=1)
        # node_conf_ok (K,): whether the replayed joints have the quadrants and the branch of the confdata.
        wrong = straight & (no_solution | (deviation > MAX_JOINT_STEP_RAD) | ~motion.node_conf_ok[arm])
        worst = max(worst, float(np.rad2deg(deviation[straight].max()))) if straight.any() else worst
        for i in np.flatnonzero(wrong):
            fault = (
                "select no joint solution"
                if no_solution[i]
                else "select another joint solution than the motion"
            )
            issues.append(node_issue("verify.confdata", f"the confdata {fault}", context.motion, arm, int(i)))
    return RuleOutcome(tuple(issues), worst, float(np.rad2deg(MAX_JOINT_STEP_RAD)), "deg")


def _nonzero_confdata(task: TaskText) -> Iterator[Issue]:
    """Yield an issue for each target with a confdata entry other than 0, for an arm with an offset wrist.

    No source states how the controller numbers the postures of such an arm. A controller that evaluates the
    confdata might choose another posture than the motion has.
    """
    for step in task.steps:
        if isinstance(step, MoveStep) and isinstance(step.target, RobTarget) and any(step.target.conf or ()):
            shown = ",".join(map(str, step.target.conf or ()))
            message = f"the confdata are [{shown}]; this arm needs [0,0,0,0]: its postures are not numbered"
            yield step_issue("verify.confdata", message, task, step)
