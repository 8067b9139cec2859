"""Entry point of the writers: converts a plan to program files, and returns reasons why this is impossible.

Each arm gets the language of its controller. Besides the programs there are files for the configuration of
the controllers: for power that programs switch, and for wires by which two controllers observe each other.
"""

from collections.abc import Sequence
from typing import Final

from planner.geometry.arrays import FloatArray
from planner.issues import Issue, TandemError
from planner.languages.writing import handshake
from planner.languages.writing.handshake import handshake_refusals
from planner.languages.writing.language import (
    Margins,
    PoweredSignals,
    Writer,
    WrittenPrograms,
    writer_of,
    writers,
    writers_in_use,
)
from planner.languages.writing.layout import LINE_END, JobPrograms, TaskProgram
from planner.languages.writing.refusals import controller_refusals, name_refusals, used_arms
from planner.languages.writing.steps import build_job
from planner.plans import Plan
from planner.problem import Problem, torch_signals
from planner.targets import Targets

CONTROLLER_FOLDER: Final = "controller"
"""Folder of files for the configuration of controllers, beside the programs."""


def refusals(problem: Problem, targets: Sequence[Targets]) -> tuple[Issue, ...]:
    """Return the reasons why no program can be written, however the targets are planned.

    Args:
        problem: The problem.
        targets: Targets of each operation.
    """
    uses_handshake = problem.cell.controller.sync == "handshake"
    languages = dict.fromkeys(writer for _, writer in writers().values())
    return (
        *controller_refusals(problem, targets),
        *(issue for writer in languages for issue in writer.refuse_settings(problem, targets)),
        *name_refusals(problem, targets),
        *(handshake_refusals(problem, targets) if uses_handshake else ()),
    )


def program_files(plan: Plan, problem: Problem, margins: Margins | None = None) -> dict[str, str]:
    """Return the texts of the program files by relative name.

    Examples: ``T_ROB1/TandemMain_1.mod``; for two controllers, and for KUKA and UR arms, in folders by arm,
    such as ``left/TandemMain_1.mod``, ``left/ruled_wall.src`` or ``left/ruled_wall.script``; for arms that
    trajectories drive, one file ``ruled_wall.trajectory.jsonl``. Each arm gets the language of its
    controller. Files for the controllers themselves are in ``controller/``.

    Args:
        plan: The plan.
        problem: Problem of the plan.
        margins: Results of the proof as text by name, for the comments of the headers.

    Raises:
        TandemError: The plan cannot be written (``post.*``).
    """
    return write_programs(plan, problem, margins).files


def write_programs(plan: Plan, problem: Problem, margins: Margins | None = None) -> WrittenPrograms:
    """Return the program files of :func:`program_files` together with the clocks that they change.

    Args:
        plan: The plan.
        problem: Problem of the plan.
        margins: Results of the proof as text by name.

    Raises:
        TandemError: The plan cannot be written (``post.*``).
    """
    return _write_all(_job(plan, problem), plan, problem, margins or {})


def program_notes(plan: Plan, problem: Problem) -> tuple[Issue, ...]:
    """Return notes on the programs: the drift of arms that meet by handshake, and notes of their languages.

    The programs are written only if a language has notes, which may depend on their texts.

    Args:
        plan: The plan.
        problem: Problem of the plan.

    Raises:
        TandemError: The plan cannot be written (``post.*``).
    """
    arms = used_arms(problem, [operation.targets for operation in plan.operations])
    has_notes = any(writer.notes is not None for writer in writers_in_use(arms))
    if problem.cell.controller.sync != "handshake" and not has_notes:
        return ()
    job = _job(plan, problem)
    files = _write_all(job, plan, problem, {}).files if has_notes else {}
    return (
        *handshake.drift_issues(job),
        *(
            issue
            for writer, tasks in _by_language(job)
            if writer.notes is not None
            for issue in writer.notes(tasks, plan, problem, files)
        ),
    )


def _job(plan: Plan, problem: Problem) -> JobPrograms:
    """Return the steps of every task, after a check that the controllers can do the job."""
    issues = controller_refusals(problem, [operation.targets for operation in plan.operations])
    if issues:
        raise TandemError(issues)
    return build_job(plan, problem)


def _by_language(job: JobPrograms) -> list[tuple[Writer, list[TaskProgram]]]:
    """Return the writers in use, each with the tasks of its language."""
    in_use = writers_in_use(task.arm for task in job.tasks)
    return [(writer, [task for task in job.tasks if writer_of(task.arm) is writer]) for writer in in_use]


def _write_all(job: JobPrograms, plan: Plan, problem: Problem, margins: Margins) -> WrittenPrograms:
    """Return the programs of all languages together with the files for the controllers."""
    files: dict[str, str] = {}
    clocks: dict[int, FloatArray] = {}
    for writer, tasks in _by_language(job):
        written = writer.write(tasks, job, plan, problem, margins)
        files |= written.files
        clocks |= written.clocks
    return WrittenPrograms(files | _controller_files(job, plan, problem), clocks)


def _controller_files(job: JobPrograms, plan: Plan, problem: Problem) -> dict[str, str]:
    """Return the files for the controllers by relative name, such as ``controller/T_ROB1/EIO.cfg``.

    Each controller has a folder, named after its first task, or after its arm if each arm has a controller.
    A single controller has files only if something is powered. Two controllers always have files, for the
    wires by which each knows that the other one runs.
    """
    controller = problem.cell.controller
    actions = [action for operation in plan.operations for action in operation.targets.actions]
    powered = {action.signal for action in actions if action.switches_power}
    torches = powered & torch_signals(problem.operations)
    powered_by_arm = {
        task.arm.name: sorted(
            (signal for signal in job.switched_signals(task) if signal in powered), key=str.lower
        )
        for task in job.tasks
    }
    torches_by_arm = {
        arm: [signal for signal in signals if signal in torches] for arm, signals in powered_by_arm.items()
    }
    wires = controller.handshake.running_wires(list(torches_by_arm)) if job.handshake is not None else ()
    out: dict[str, str] = {}
    for folder, tasks in _controller_groups(job, controller.sync):
        arm, build_files = tasks[0].arm.name, writer_of(tasks[0].arm).controller_files
        if build_files is None or not (powered_by_arm[arm] or wires):
            continue
        files = build_files(
            job, tasks, controller, PoweredSignals(powered_by_arm[arm], torches_by_arm[arm], wires)
        )
        if wires and any(torches_by_arm.values()):
            files["README.txt"] = files.get("README.txt", "") + handshake.torch_restart_section(
                torches_by_arm, arm
            )
        for name, text in files.items():
            out[f"{CONTROLLER_FOLDER}/{folder}/{name}"] = text.replace("\n", LINE_END)
    return out


def _controller_groups(job: JobPrograms, sync: str) -> list[tuple[str, Sequence[TaskProgram]]]:
    """Return the name of each controller's folder, and the tasks that run on the controller.

    A MultiMove controller runs all tasks, and its folder is named after the first one. Otherwise each arm has
    a controller of its own, and the folder has the arm's name.
    """
    first = job.tasks[0]
    if sync == "multimove" and sync in writer_of(first.arm).syncs:
        return [(first.task, job.tasks)]
    return [(task.arm.name, [task]) for task in job.tasks]
