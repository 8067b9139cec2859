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
            continue  # verify.status covers KRL; movel keeps the posture that movej has reached
        if task.arm.data.has_unnamed_postures:
            # such arms run with ConfL\Off; with parallel rods the numbers of single axes are still valid
            if arm_model.robot_machine(task.arm.data).is_followed:
                issues += list(_nonzero_confdata(task))
            continue
        selected = motion.node_conf_q[arm]
        joint_values = motion.q[arm][motion.node_sample]
        straight = straight_nodes(context, arm)
        no_solution = straight & ~np.isfinite(selected).all(axis=1)
        deviation = np.abs(np.where(np.isfinite(selected), selected, joint_values) - joint_values).max(axis=1)
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
    """Issues of targets with nonzero confdata, for an arm whose numbering of postures is not known.

    A controller that evaluates them might choose another posture than the motion has.
    """
    for step in task.steps:
        if isinstance(step, MoveStep) and isinstance(step.target, RobTarget) and any(step.target.conf or ()):
            shown = ",".join(map(str, step.target.conf or ()))
            message = f"the confdata are [{shown}]; this arm needs [0,0,0,0]: its postures are not numbered"
            yield step_issue("verify.confdata", message, task, step)
