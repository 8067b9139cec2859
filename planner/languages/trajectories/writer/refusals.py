"""Refusals of jobs that trajectory files cannot express."""

from collections.abc import Sequence

from planner.issues import Issue
from planner.languages.trajectories.writer import program as trajectories
from planner.languages.trajectories.writer import rows as trajectory_rows
from planner.problem import Arm, Problem, lights_torch
from planner.targets import Targets


def refuse(problem: Problem, targets: Sequence[Targets], arms: Sequence[Arm]) -> list[Issue]:
    """Return the reasons why arms that trajectories drive cannot do a job: joint names and torches.

    Args:
        problem: The problem.
        targets: Not used.
        arms: The arms.
    """
    del targets
    issues = []
    seen: dict[str, str] = {}
    for arm in arms:
        for joint in trajectories.joint_names(arm, problem.cell.controller):
            other = seen.setdefault(joint, arm.name)
            if other != arm.name:
                got = f"arms {other} and {arm.name} both have a joint {joint}, and one controller moves both"
                hint = f"controller: {{joint_prefix: {{{other}: {other}_, {arm.name}: {arm.name}_}}}}, as "
                hint += "in the controller's configuration"
                field = "controller.joint_prefix"
                issues.append(Issue("post.name", got, field=field, arm=arm.name, hint=hint))
                break
            if trajectory_rows.NAME.fullmatch(joint) is None:
                got = f"{joint!r}, a joint of arm {arm.name}, is not valid in a trajectory file; "
                got += "allowed: a letter, then letters, digits and _ / . -, 100 at most"
                hint = (
                    "rename it in the URDF, or add a prefix with a letter (controller: joint_prefix), also "
                )
                hint += "at the controller"
                issues.append(Issue("post.name", got, arm=arm.name, hint=hint))
    lit = [operation for operation in problem.operations if lights_torch(operation)]
    issues += [trajectories.torch_issue(lit[0].arms[0])] if lit else []
    return issues
