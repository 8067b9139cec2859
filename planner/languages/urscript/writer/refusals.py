"""Jobs that programs of UR controllers cannot do."""

import itertools
from collections.abc import Iterator, Sequence

from planner.issues import Issue, TandemError
from planner.languages.urscript.writer import program
from planner.languages.writing.refusals import unnumbered_signals
from planner.problem import Arm, Problem, lights_torch
from planner.targets import Targets


def refuse(problem: Problem, targets_of_operations: Sequence[Targets], arms: Sequence[Arm]) -> list[Issue]:
    """Return the issues that prevent UR arms from doing a job.

    They are:

    - ``post.controller``: two arms that meet by another handshake than four-phase, a torch beside another
      arm, and a wait for an input that is not that of a torch
    - ``post.signal``: a signal without a number, and a running wire whose number is also that of an output of
      the other arm
    - ``post.load``: an arm that holds the block
    - ``post.ur_arm``: an arm whose joints or flange are not those of UR

    Args:
        problem: The problem.
        targets_of_operations: Targets of each operation.
        arms: The UR arms.
    """
    several_arms = len(arms) > 1
    if several_arms and problem.cell.controller.handshake.kind != "four_phase":
        names = " and ".join(f"{arm.name} ({arm.robot})" for arm in arms)
        what = f"{names} cannot work in one job: with a toggle a UR program cannot detect at every second "
        what += "meeting whether the other one was restarted while it asked a question"
        hint = "controller: {handshake: {kind: four_phase}}"
        return [Issue("post.controller", what, hint=hint)]
    issues: list[Issue] = []
    for arm in arms:
        torches = [
            operation
            for operation in problem.operations
            if lights_torch(operation) and arm.name in operation.arms
        ]
        if torches and several_arms:
            issues.append(_no_torch(arm))
        else:
            torch_inputs = {getattr(operation, "ok_signal", None) for operation in torches}
            inputs = (
                action
                for targets in targets_of_operations
                for action in targets.actions
                if action.kind == "input" and targets.arms[0] == arm.name
            )
            inputs = (action for action in inputs if action.signal not in torch_inputs)
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
    """Yield an issue if the program of ``arm`` would also run on the other controller (``post.signal``).

    Only signal numbers distinguish two arms of one model: the number of the running output of one must not
    belong to an output of the other.
    """
    controller = problem.cell.controller
    running = controller.handshake.of(arm.name).running
    number = controller.signal_number(arm.name, running)
    other_signals = controller.handshake.of(other.name)
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
