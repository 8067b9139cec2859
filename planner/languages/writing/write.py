"""The door of this package: a plan and its problem in, program files out; what no program can say.

Each arm gets the language of its controller. Beside the programs go files for the controllers: for
power that they switch, and for wires by which two of them know of each other.
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
from planner.languages.writing.layout import LINE_END, Job, TaskProgram
from planner.languages.writing.refusals import controller_refusals, name_refusals, used
from planner.languages.writing.steps import build
from planner.plans import Plan
from planner.problem import Problem, torch_signals
from planner.targets import Targets

CONTROLLER_FOLDER: Final = "controller"
"""Folder of files for a controller's configuration, beside the programs."""


def refusals(problem: Problem, targets: Sequence[Targets]) -> tuple[Issue, ...]:
    """Why no program can be written for these targets, one an operation, however they are planned."""
    alone = problem.cell.controller.sync == "handshake"
    languages = dict.fromkeys(writer for _, writer in writers().values())
    return (
        *controller_refusals(problem, targets),
        *(issue for writer in languages for issue in writer.refuse_settings(problem, targets)),
        *name_refusals(problem, targets),
        *(handshake_refusals(problem, targets) if alone else ()),
    )


def programs(plan: Plan, problem: Problem, margins: Margins | None = None) -> dict[str, str]:
    """Texts of the program files by relative name, such as ``T_ROB1/TandemMain_1.mod``; of two controllers,
    and of KUKA's and UR's arms, in folders by arm, such as ``left/TandemMain_1.mod``, ``left/ruled_wall.src``
    or ``left/ruled_wall.script``; of arms that trajectories drive one file, ``ruled_wall.trajectory.jsonl``.

    Each arm gets the language of its controller; files for the controllers themselves are in
    ``controller/``. ``margins``: results of the proof by name, as text; they go into the headers' comments
    only. Raises :class:`TandemError` with codes ``post.*`` when the plan cannot be written.
    """
    return written(plan, problem, margins).files


def written(plan: Plan, problem: Problem, margins: Margins | None = None) -> WrittenPrograms:
    """As :func:`programs`, with what the process has to know of their clocks."""
    return _texts(_job(plan, problem), plan, problem, margins or {})


def notes(plan: Plan, problem: Problem) -> tuple[Issue, ...]:
    """What the user should know of the programs beside their text: the drift of arms that meet by handshake,
    and what their languages say of them.

    Raises as :func:`programs` does.
    """
    arms = used(problem, [operation.targets for operation in plan.operations])
    noted = [writer.notes is not None for writer in writers_in_use(arms)]
    if problem.cell.controller.sync != "handshake" and not any(noted):
        return ()
    job = _job(plan, problem)
    files = _texts(job, plan, problem, {}).files if any(noted) else {}
    return (
        *handshake.drift_issues(job),
        *(
            issue
            for writer, tasks in _by_language(job)
            if writer.notes is not None
            for issue in writer.notes(tasks, plan, problem, files)
        ),
    )


def _job(plan: Plan, problem: Problem) -> Job:
    issues = controller_refusals(problem, [operation.targets for operation in plan.operations])
    if issues:
        raise TandemError(issues)
    return build(plan, problem)


def _by_language(job: Job) -> list[tuple[Writer, list[TaskProgram]]]:
    in_use = writers_in_use(task.arm for task in job.tasks)
    return [(writer, [task for task in job.tasks if writer_of(task.arm) is writer]) for writer in in_use]


def _texts(job: Job, plan: Plan, problem: Problem, margins: Margins) -> WrittenPrograms:
    files, clocks = dict[str, str](), dict[int, FloatArray]()
    for writer, tasks in _by_language(job):
        out = writer.write(tasks, job, plan, problem, margins)
        files |= out.files
        clocks |= out.clocks
    return WrittenPrograms(files | _controller_files(job, plan, problem), clocks)


def _controller_files(job: Job, plan: Plan, problem: Problem) -> dict[str, str]:
    """Files by relative name, such as ``controller/T_ROB1/EIO.cfg``, in a folder for each controller: by its
    first task, or by its arm where each arm has one. One controller has none where nothing is powered; two
    have them always, for the wires by which each knows that the other one runs."""
    controller = problem.cell.controller
    actions = [action for operation in plan.operations for action in operation.targets.actions]
    powered = {action.signal for action in actions if action.powers}
    torches = powered & torch_signals(problem.operations)
    switched = {
        task.arm.name: sorted((signal for signal in job.switched(task) if signal in powered), key=str.lower)
        for task in job.tasks
    }
    lit = {arm: [signal for signal in signals if signal in torches] for arm, signals in switched.items()}
    wires = controller.handshake.wired_running(list(lit)) if job.handshake is not None else ()
    out: dict[str, str] = {}
    for folder, tasks in _controllers(job, controller.sync):
        arm, make = tasks[0].arm.name, writer_of(tasks[0].arm).controller_files
        if make is None or not (switched[arm] or wires):
            continue
        files = make(job, tasks, controller, PoweredSignals(switched[arm], lit[arm], wires))
        if wires and any(lit.values()):
            files["README.txt"] = files.get("README.txt", "") + handshake.burned_anew(lit, arm)
        for name, text in files.items():
            out[f"{CONTROLLER_FOLDER}/{folder}/{name}"] = text.replace("\n", LINE_END)
    return out


def _controllers(job: Job, sync: str) -> list[tuple[str, Sequence[TaskProgram]]]:
    first = job.tasks[0]
    if sync == "multimove" and sync in writer_of(first.arm).syncs:
        return [(first.task, job.tasks)]
    return [(task.arm.name, [task]) for task in job.tasks]
