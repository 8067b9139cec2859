"""Refusals of jobs that trajectory files cannot express."""

from collections.abc import Sequence

from planner.issues import Issue
from planner.languages.trajectories.writer import program as trajectories
from planner.languages.trajectories.writer import rows as trajectory_rows
from planner.problem import Arm, Problem, lights_torch
from planner.targets import Targets


def refuse(problem: Problem, targets: Sequence[Targets], arms: Sequence[Arm]) -> list[Issue]:
    """Return the issues that prevent trajectories from driving arms in a job: joint names and torches.

    Args:
        problem: The problem.
        targets: Not used.
        arms: The arms.
    """
    del targets
    issues = []
    arm_by_joint: dict[str, str] = {}
    for arm in arms:
        for joint in trajectories.joint_names(arm, problem.cell.controller):
            other = arm_by_joint.setdefault(joint, arm.name)
            if other != arm.name:
                message = (
                    f"arms {other} and {arm.name} both have a joint {joint}, and one controller moves both"
                )
                hint = f"controller: {{joint_prefix: {{{other}: {other}_, {arm.name}: {arm.name}_}}}}, as "
                hint += "in the controller's configuration"
                field = "controller.joint_prefix"
                issues.append(Issue("post.name", message, field=field, arm=arm.name, hint=hint))
                break
            if trajectory_rows.NAME.fullmatch(joint) is None:
                message = f"{joint!r}, a joint of arm {arm.name}, is not valid in a trajectory file; "
                message += "allowed: a letter, then letters, digits and _ / . -, 100 at most"
                hint = (
                    "rename it in the URDF, or add a prefix with a letter (controller: joint_prefix), also "
                )
                hint += "at the controller"
                issues.append(Issue("post.name", message, arm=arm.name, hint=hint))
    torch_operations = [operation for operation in problem.operations if lights_torch(operation)]
    if torch_operations:
        issues.append(trajectories.torch_issue(torch_operations[0].arms[0]))
    return issues
