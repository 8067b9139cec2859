"""The rule on configuration data of RAPID targets."""

from collections.abc import Iterator

import numpy as np

from planner.issues import Issue
from planner.languages.rapid.reader.program_text import RapidText
from planner.programs.stages import TaskText
from planner.programs.steps import MoveStep, RobTarget
from planner.proof.context import Context
from planner.proof.kinematics import arm_model
from planner.proof.rule import Outcome, at_node, at_step, rule
from planner.proof.rules.robot_motion import JOINT_JUMP, straight_nodes


@rule("verify.confdata")
def confdata(context: Context) -> Outcome:
    """RAPID: confdata alone select the joint solution that the motion has at each target; those of an arm
    with an offset wrist are all 0."""
    motion = context.motion
    issues, worst = [], 0.0
    for task in context.job.tasks:
        arm = task.arm.name
        if not isinstance(task.text, RapidText):
            continue  # verify.status asks the same of KRL; movel keeps the posture that movej has reached
        if task.arm.data.unnamed:
            # such arms run with ConfL\Off; with parallel rods the numbers of single axes mean what they say
            if arm_model.machine_of(task.arm.data).followed:
                issues += list(_named_postures(task))
            continue
        selected, here = motion.node_conf_q[arm], motion.q[arm][motion.node_sample]
        straight = straight_nodes(context, arm)
        none = straight & ~np.isfinite(selected).all(axis=1)
        far = np.abs(np.where(np.isfinite(selected), selected, here) - here).max(axis=1)
        wrong = straight & (none | (far > JOINT_JUMP) | ~motion.node_conf_ok[arm])
        worst = max(worst, float(np.rad2deg(far[straight].max()))) if straight.any() else worst
        for i in np.flatnonzero(wrong):
            what = (
                "select no joint solution" if none[i] else "select another joint solution than the motion has"
            )
            issues.append(at_node("verify.confdata", f"the confdata {what}", context.motion, arm, int(i)))
    return Outcome(tuple(issues), worst, float(np.rad2deg(JOINT_JUMP)), "deg")


def _named_postures(task: TaskText) -> Iterator[Issue]:
    """Targets that name a posture of an arm of which nobody knows how confdata name them: a controller that
    heeds them might take another one than the motion has."""
    for step in task.steps:
        if isinstance(step, MoveStep) and isinstance(step.target, RobTarget) and any(step.target.conf or ()):
            shown = ",".join(map(str, step.target.conf or ()))
            what = f"the confdata are [{shown}]; of this arm they are [0,0,0,0], as postures have no names"
            yield at_step("verify.confdata", what, task, step)
