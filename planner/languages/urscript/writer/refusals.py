"""Jobs that programs of UR controllers cannot do."""

import itertools
from collections.abc import Iterator, Sequence

from planner.issues import Issue, TandemError
from planner.languages.urscript.writer import program
from planner.languages.writing.refusals import unnumbered_signals
from planner.problem import Arm, Problem, lights_torch
from planner.targets import Targets


def refuse(problem: Problem, targets_of_operations: Sequence[Targets], arms: Sequence[Arm]) -> list[Issue]:
    """Return why UR arms cannot do a job.

    Reasons are torches, inputs or handshakes that URScript is not written for (``post.controller``),
    signals without a number (``post.signal``), arms that hold the block (``post.load``), and arms that are
    not UR's (``post.ur_arm``).
    """
    together = len(arms) > 1
    if together and problem.cell.controller.handshake.kind != "four_phase":
        names = " and ".join(f"{arm.name} ({arm.robot})" for arm in arms)
        what = f"{names} cannot work in one job: with a toggle a UR program cannot detect at every second "
        what += "meeting whether the other one was restarted while it asked a question"
        hint = "controller: {handshake: {kind: four_phase}}"
        return [Issue("post.controller", what, hint=hint)]
    issues: list[Issue] = []
    for arm in arms:
        torches = [o for o in problem.operations if lights_torch(o) and arm.name in o.arms]
        if torches and together:
            issues.append(_no_torch(arm))
        else:
            known = {getattr(operation, "ok_signal", None) for operation in torches}
            inputs = (
                a
                for t in targets_of_operations
                for a in t.actions
                if a.kind == "input" and t.arms[0] == arm.name
            )
            inputs = (action for action in inputs if action.signal not in known)
            issues += [program.no_input(action, arm.name) for action in itertools.islice(inputs, 1)]
        issues += unnumbered_signals(problem, targets_of_operations, arm, "URScript")
    if len(arms) == 2:
        issues += [
            *_exchangeable_programs(problem, arms[0], arms[1]),
            *_exchangeable_programs(problem, arms[1], arms[0]),
        ]
    holders = dict.fromkeys(setup.stock.held_by for setup in problem.setups)
    issues += [program.no_load(arm.name) for arm in arms if arm.name in holders]
    for arm in arms:
        try:
            program.controller_base(arm)
        except TandemError as error:
            issues += error.issues
    return issues


def _no_torch(arm: Arm) -> Issue:
    """Return the issue that a UR arm cannot cut with a torch beside another arm."""
    what = f"arm {arm.name} ({arm.robot}) has to cut with a torch beside another UR arm: while one of both "
    what += "programs waits, the time for which the torch burns at one point is unknown"
    hint = "cut in a job of its own, with one arm, or by a mill (by: {kind: mill})"
    return Issue("post.controller", what, arm=arm.name, hint=hint)


def _exchangeable_programs(problem: Problem, arm: Arm, other: Arm) -> Iterator[Issue]:
    """Report a UR controller on which the other one's program would run (``post.signal``).

    Only signal numbers distinguish two arms of one model, so the running output of one must not be used at
    the other one.
    """
    controller = problem.cell.controller
    running = controller.handshake.of(arm.name).running
    number, other_signals = controller.signal_number(arm.name, running), controller.handshake.of(other.name)
    inputs = {other_signals.input.lower(), other_signals.partner_running.lower()}
    taken = [
        signal
        for signal, value in controller.io.get(other.name, {}).items()
        if value == number and signal.lower() not in inputs
    ]
    if number is not None and taken:
        got = f"{running} of arm {arm.name} is output {number}, as {taken[0]} of arm {other.name} is"
        what = f"{got}; programs copied to each other's controller would run there unnoticed"
        hint = f"use an output for {running} of arm {arm.name} that arm {other.name} does not use"
        field = f"controller.io.{arm.name}.{running}"
        yield Issue("post.signal", what, field=field, arm=arm.name, hint=hint)
