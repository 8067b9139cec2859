"""The tasks of all arms that one file moves."""

from collections.abc import Mapping
from typing import Final

from planner.languages.trajectories.reader import flow, rows
from planner.languages.trajectories.reader.program_text import TrajectoryText
from planner.problem import Arm, Problem
from planner.programs.language import Arms, Files, Reader, ReadTasks, Sharing
from planner.programs.stages import TaskText
from planner.programs.steps import Fault, FlowError, Step


def _read(problem: Problem, arms: Arms, files: Files) -> ReadTasks:
    file = sorted(files)[0]
    program, faults = rows.read(file, files[file], problem.cell.controller.max_bytes)
    lost: list[Fault] = []
    if len(files) > 1:
        what = f"{len(files)} files of trajectories, {', '.join(sorted(files))}; one clock moves all arms, "
        what += "so that one file is wanted"
        faults = (*faults, Fault(1, 1, "trajectory.name_file", what, sorted(files)[1]))
    if program is None:
        return ReadTasks((), faults, tuple(lost))
    steps: Mapping[str, tuple[Step, ...]] = {}
    wanted = {name: _joint_names(problem, arm) for name, arm in arms.items()}
    for row in program.arms:
        if row.arm not in wanted:
            what = f"there is no arm {row.arm} that trajectories move; known are {', '.join(wanted)}"
            lost.append(Fault(row.line, 1, "trajectory.flow", what, file))
        elif row.robot != arms[row.arm].robot:
            what = f"arm {row.arm} is said to be {row.robot}; wanted: {arms[row.arm].robot}"
            lost.append(Fault(row.line, 1, "trajectory.flow", what, file))
        elif row.joints != wanted[row.arm]:
            what = f"the joints of {row.arm} ({row.robot}) are {', '.join(row.joints)}; wanted: "
            what += f"{', '.join(wanted[row.arm])}, in this order"
            lost.append(Fault(row.line, 1, "trajectory.flow", what, file))
    order = [row.arm for row in program.arms]
    if order != [name for name in wanted if name in order]:
        what = f"the arms stand as {', '.join(order)}; wanted: the cell's order"
        lost.append(Fault(program.arms[0].line, 1, "trajectory.flow", what, file))
    if not lost:
        try:
            steps = flow.flow(program, {name: arm.data for name, arm in arms.items()})
        except FlowError as wrong:
            lost += wrong.faults
    tasks = []
    for row in program.arms:
        if row.arm in arms:
            text = TrajectoryText(program, flow.pose(row.base))
            way = steps.get(row.arm, ())
            tasks.append(TaskText(row.arm, arms[row.arm], text, way, files, unit=row.arm))
    return ReadTasks(tuple(tasks), faults, tuple(lost))


def _joint_names(problem: Problem, arm: Arm) -> tuple[str, ...]:
    """What a controller of trajectories calls the joints of an arm: the names of its URDF behind the prefix
    that the cell states."""
    prefix = problem.cell.controller.joint_prefix.get(arm.name, "")
    return tuple(f"{prefix}{name}" for name in arm.data.joints)


READER: Final = Reader(read=_read, sharing=Sharing.FILE)
