"""Reads the tasks of all arms that one file moves."""

from collections.abc import Mapping
from typing import Final

from planner.languages.trajectories.reader import flow, rows
from planner.languages.trajectories.reader.program_text import TrajectoryText
from planner.problem import Arm, Problem
from planner.programs.language import Arms, Files, Reader, ReadTasks, Sharing
from planner.programs.stages import TaskText
from planner.programs.steps import FlowError, ProgramStep, TextFault


def _read(problem: Problem, arms: Arms, files: Files) -> ReadTasks:
    """Read a trajectory file as one task for each of its arms that the cell has.

    Arms, robots and joints of the file must be those of the cell, in the cell's order. Otherwise the tasks
    have no steps, because columns of joints could not be assigned. More than one file is a fault; the first
    one by name is then read.
    """
    file = sorted(files)[0]
    program, faults = rows.read(file, files[file], problem.cell.controller.max_bytes)
    flow_faults: list[TextFault] = []
    if len(files) > 1:
        message = (
            f"{len(files)} files of trajectories, {', '.join(sorted(files))}; one clock moves all arms, "
        )
        message += "so that only one file is allowed"
        faults = (*faults, TextFault(1, 1, "trajectory.name_file", message, sorted(files)[1]))
    if program is None:
        return ReadTasks((), faults, tuple(flow_faults))
    steps: Mapping[str, tuple[ProgramStep, ...]] = {}
    joint_names = {name: _joint_names(problem, arm) for name, arm in arms.items()}
    for row in program.arms:
        if row.arm not in joint_names:
            message = f"trajectories move no arm {row.arm}; allowed: {', '.join(joint_names)}"
            flow_faults.append(TextFault(row.line, 1, "trajectory.flow", message, file))
        elif row.robot != arms[row.arm].robot:
            message = f"arm {row.arm} is stated as {row.robot}; expected: {arms[row.arm].robot}"
            flow_faults.append(TextFault(row.line, 1, "trajectory.flow", message, file))
        elif row.joints != joint_names[row.arm]:
            message = f"the joints of {row.arm} ({row.robot}) are {', '.join(row.joints)}; expected: "
            message += f"{', '.join(joint_names[row.arm])}, in this order"
            flow_faults.append(TextFault(row.line, 1, "trajectory.flow", message, file))
    order = [row.arm for row in program.arms]
    if order != [name for name in joint_names if name in order]:
        message = f"the order of the arms is {', '.join(order)}; expected: the cell's order"
        flow_faults.append(TextFault(program.arms[0].line, 1, "trajectory.flow", message, file))
    if not flow_faults:
        try:
            steps = flow.main_flow(program, {name: arm.data for name, arm in arms.items()})
        except FlowError as wrong:
            flow_faults += wrong.faults
    tasks = []
    for row in program.arms:
        if row.arm in arms:
            text = TrajectoryText(program, flow.pose(row.base))
            arm_steps = steps.get(row.arm, ())
            tasks.append(TaskText(row.arm, arms[row.arm], text, arm_steps, files, unit=row.arm))
    return ReadTasks(tuple(tasks), faults, tuple(flow_faults))


def _joint_names(problem: Problem, arm: Arm) -> tuple[str, ...]:
    """Return the names of an arm's joints at the controller.

    These are the names in the URDF, with the prefix that the cell states.
    """
    prefix = problem.cell.controller.joint_prefix.get(arm.name, "")
    return tuple(f"{prefix}{name}" for name in arm.data.joints)


READER: Final = Reader(read=_read, sharing=Sharing.FILE)
