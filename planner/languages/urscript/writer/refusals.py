"""What programs of UR's controllers cannot do."""

import itertools
from collections.abc import Iterator, Sequence

from planner.issues import Issue, TandemError
from planner.languages.urscript.writer import program
from planner.languages.writing.refusals import unnumbered
from planner.problem import Arm, Problem, lights_torch
from planner.targets import Targets


def refuse(problem: Problem, made: Sequence[Targets], arms: Sequence[Arm]) -> list[Issue]:
    """Return why arms of UR cannot do a job: torches, inputs or handshakes that URScript is not written for
    (``post.controller``), signals without a number (``post.signal``), arms that hold the block
    (``post.load``) or are none of UR's (``post.ur_arm``)."""
    together = len(arms) > 1
    if together and problem.cell.controller.handshake.kind != "four_phase":
        names = " and ".join(f"{arm.name} ({arm.robot})" for arm in arms)
        what = f"{names} cannot work in one job: by a toggle a program of UR cannot tell at every second "
        what += "meeting whether the other one was started anew while it asked somebody"
        hint = "controller: {handshake: {kind: four_phase}}"
        return [Issue("post.controller", what, hint=hint)]
    issues: list[Issue] = []
    for arm in arms:
        torches = [o for o in problem.operations if lights_torch(o) and arm.name in o.arms]
        if torches and together:
            issues.append(_no_torch(arm))
        else:
            known = {getattr(operation, "ok_signal", None) for operation in torches}
            inputs = (a for t in made for a in t.actions if a.kind == "input" and t.arms[0] == arm.name)
            inputs = (action for action in inputs if action.signal not in known)
            issues += [program.no_input(action, arm.name) for action in itertools.islice(inputs, 1)]
        issues += unnumbered(problem, made, arm, "URScript")
    if len(arms) == 2:
        issues += [*_exchanged(problem, arms[0], arms[1]), *_exchanged(problem, arms[1], arms[0])]
    holders = dict.fromkeys(setup.stock.held_by for setup in problem.setups)
    issues += [program.no_load(arm.name) for arm in arms if arm.name in holders]
    for arm in arms:
        try:
            program.controller_base(arm)
        except TandemError as error:
            issues += error.issues
    return issues


def _no_torch(arm: Arm) -> Issue:
    """Why an arm of UR cuts with no torch beside another one."""
    what = f"arm {arm.name} ({arm.robot}) is to cut with a torch beside another arm of UR: while one of both "
    what += "programs waits, nothing is known of how long the torch would burn at one place"
    hint = "cut in a job of its own, with one arm, or by a mill (by: {kind: mill})"
    return Issue("post.controller", what, arm=arm.name, hint=hint)


def _exchanged(problem: Problem, arm: Arm, other: Arm) -> Iterator[Issue]:
    """A controller of UR on which the other one's program would run (``post.signal``): nothing but numbers
    tells two arms of one model apart, so what says that one runs must be nothing at the other one."""
    controller = problem.cell.controller
    running = controller.handshake.of(arm.name).running
    number, theirs = controller.number(arm.name, running), controller.handshake.of(other.name)
    inputs = {theirs.input.lower(), theirs.partner_running.lower()}
    taken = [
        signal
        for signal, value in controller.io.get(other.name, {}).items()
        if value == number and signal.lower() not in inputs
    ]
    if number is not None and taken:
        got = f"{running} of arm {arm.name} is output {number}, as {taken[0]} of arm {other.name} is"
        what = f"{got}; programs copied to each other's controller would run there unnoticed"
        hint = f"take an output for {running} of arm {arm.name} that arm {other.name} does not use"
        field = f"controller.io.{arm.name}.{running}"
        yield Issue("post.signal", what, field=field, arm=arm.name, hint=hint)
