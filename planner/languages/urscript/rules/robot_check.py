"""The robot check at the start of URScript programs."""

import numpy as np

from planner.geometry.arrays import inverse
from planner.languages.urscript.reader.flow import ARM_CHECK_KIND
from planner.languages.urscript.reader.reader import pose
from planner.languages.urscript.reader.syntax_tree import CHECK_POINT, MAX_CHECK_TOLERANCE_M
from planner.programs.stages import TaskText
from planner.programs.steps import ProgramStep, SettingStep
from planner.proof.context import Context
from planner.proof.kinematics import arm_model
from planner.proof.rule import RuleOutcome, mm, step_issue
from planner.proof.rules.controller_files import CELL_CHECK
from planner.proof.rules.setups_and_frames import FRAME_TOLERANCE_M, HOME_TOLERANCE_RAD


def robot_check(context: Context, task: TaskText) -> RuleOutcome:
    """Check the statements by which a program verifies that it moves the planned arm (verify.cell_check)."""
    return RuleOutcome(
        tuple(step_issue(CELL_CHECK, fault, task, step) for step, fault in _check_faults(task))
    )


def _check_faults(task: TaskText) -> list[tuple[ProgramStep | None, str]]:
    """Return the faults of a program's check of its arm, each with its step.

    There must be one check. It computes the position of a fixed point of the flange at the home joints, which
    must be that of the planned arm within a tolerance. The step is None if there is not exactly one check.
    """
    steps = [step for step in task.steps if isinstance(step, SettingStep) and step.kind == ARM_CHECK_KIND]
    if len(steps) != 1:
        return [
            (None, f"the program checks {len(steps)} times that the arm is the planned one; required: once")
        ]
    (step,) = steps
    machine = arm_model.robot_machine(task.arm.data)
    faults: list[tuple[ProgramStep | None, str]] = []
    # joints (6,) [rad], point of the flange and expected position as poses (6,), and the tolerance [m]
    q, tip, position, tolerance = (
        np.array(step.values[first:end]) for first, end in ((0, 6), (6, 12), (12, 18), (18, 19))
    )
    if np.abs(q - task.arm.home).max() > HOME_TOLERANCE_RAD:
        faults.append((step, "the arm is not checked at its home joints"))
    if np.abs(tip[:3] - CHECK_POINT).max() > FRAME_TOLERANCE_M:
        faults.append(
            (step, f"the point of the flange is {tip[:3].tolist()} m; expected: {list(CHECK_POINT)}")
        )
    flange = inverse(machine.table.base) @ machine.flange(q)
    distance = float(np.linalg.norm((flange @ pose(tuple(tip)))[:3, 3] - position[:3]))
    if distance > FRAME_TOLERANCE_M:
        faults.append(
            (step, f"by the arm's URDF that point is {mm(distance):.4f} mm away from the program's")
        )
    if tolerance[0] > MAX_CHECK_TOLERANCE_M:
        faults.append(
            (
                step,
                f"the tolerance of the point is {mm(tolerance[0]):g} mm; allowed: "
                f"{mm(MAX_CHECK_TOLERANCE_M):g}",
            )
        )
    return faults
