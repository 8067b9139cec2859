"""Files for the controllers that the programs of a job run on: for power that they switch, and for wires by
which two of them know of each other."""

from __future__ import annotations

from typing import Final

from planner.claims_forming import SinksHolder
from planner.plans import Plan
from planner.post import controller_krl, controller_rapid
from planner.post.program import Job
from planner.problem import Problem

FOLDER: Final = "controller"
LINE_END: Final = "\r\n"


def texts(job: Job, plan: Plan, problem: Problem) -> dict[str, str]:
    """Files by relative name, such as ``controller/T_ROB1/EIO.cfg``, in a folder for each controller: by its
    first task, or by its arm where each arm has one. One controller has none where nothing is powered; two
    have them always, for the wires by which each knows that the other one runs."""
    controller = problem.cell.controller
    pulsed = {
        claim.signal
        for operation in plan.operations
        for claim in operation.targets.claims
        if isinstance(claim, SinksHolder)
    }
    alone = controller.sync == "handshake"
    arms = [task.arm.name for task in job.tasks]
    wires = controller.handshake.wired_running(arms) if job.handshake is not None else ()
    out: dict[str, str] = {}
    for task in job.tasks:
        signals = sorted((s for s in job.switched(task) if s not in pulsed), key=str.lower)
        if not signals and not wires:
            continue
        name = task.arm.name
        if task.robot.family == "KUKA":
            made, folder = controller_krl.files(controller, name, signals, wires), name
        elif alone:
            made, folder = controller_rapid.files(controller, [task.task], signals, name, wires), name
        elif task.number == 1:
            tasks = [other.task for other in job.tasks]
            made, folder = controller_rapid.files(controller, tasks, signals, name), task.task
        else:
            continue  # files of the first task are for all of one controller
        out |= {f"{FOLDER}/{folder}/{name}": text.replace("\n", LINE_END) for name, text in made.items()}
    return out
