"""The robot check at the start of URScript programs."""

import numpy as np

from planner.geometry.arrays import inverse
from planner.languages.urscript.reader.flow import LOOK_KIND
from planner.languages.urscript.reader.reader import pose
from planner.languages.urscript.reader.syntax_tree import CHECK_POINT, LOOK_ERROR
from planner.programs.stages import TaskText
from planner.programs.steps import SettingStep, Step
from planner.proof.context import Context
from planner.proof.kinematics import arm_model
from planner.proof.rule import Outcome, at_step, mm
from planner.proof.rules.controller_files import CELL_CHECK
from planner.proof.rules.setups_and_frames import FRAME_POSITION, HOME_ERROR


def robot_check(context: Context, task: TaskText) -> Outcome:
    """Faults of the comparison of the arm with the planned one (verify.cell_check)."""
    return Outcome(tuple(at_step(CELL_CHECK, fault, task, step) for step, fault in _faults(task)))


def _faults(task: TaskText) -> list[tuple[Step | None, str]]:
    """What is wrong with the look of a URScript program at its arm, step by step."""
    steps = [s for s in task.steps if isinstance(s, SettingStep) and s.kind == LOOK_KIND]
    if len(steps) != 1:
        return [
            (None, f"the program looks {len(steps)} times whether the arm is the planned one; once is due")
        ]
    (step,), machine = steps, arm_model.machine_of(task.arm.data)
    out: list[tuple[Step | None, str]] = []
    q, tip, place, most = (np.array(step.values[a:b]) for a, b in ((0, 6), (6, 12), (12, 18), (18, 19)))
    if np.abs(q - task.arm.home).max() > HOME_ERROR:
        out.append((step, "the arm is looked at elsewhere than at home"))
    if np.abs(tip[:3] - CHECK_POINT).max() > FRAME_POSITION:
        out.append((step, f"the point of the flange is {tip[:3].tolist()} m; wanted: {list(CHECK_POINT)}"))
    flange = inverse(machine.table.base) @ machine.flange(q)
    off = float(np.linalg.norm((flange @ pose(tuple(tip)))[:3, 3] - place[:3]))
    if off > FRAME_POSITION:
        out.append((step, f"the arm's URDF has that point {mm(off):.4f} mm from where the program wants it"))
    if most[0] > LOOK_ERROR:
        out.append((step, f"the point may be off by {mm(most[0]):g} mm; allowed: {mm(LOOK_ERROR):g}"))
    return out
