"""Which language each arm's controller speaks, and what that asks of the cell."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from planner.catalogue import robot
from planner.issues import Issue
from planner.problem import Arm, Problem
from planner.targets import Targets

_ALONE: Final = "one controller for both arms (sync: multimove) is ABB's; KUKA arms have one each"


def used(problem: Problem, made: Sequence[Targets]) -> list[Arm]:
    """The arms that take part in any operation, in the cell's order."""
    names = {arm for targets in made for arm in targets.arms}
    return [arm for arm in problem.cell.arms if arm.name in names]


def speaks_krl(arm: Arm) -> bool:
    """Whether an arm's controller is KUKA's."""
    return robot(arm.robot).family == "KUKA"


def refusals(problem: Problem, made: Sequence[Targets]) -> tuple[Issue, ...]:
    """Why the controllers of this cell cannot do this job, however it is planned: KUKA arms on a controller
    for both (``post.controller``), signals that KRL has no number for (``post.signal``)."""
    arms = used(problem, made)
    together = len(arms) > 1
    if together and any(map(speaks_krl, arms)) and problem.cell.controller.sync != "handshake":
        names = " and ".join(f"{arm.name} ({arm.robot})" for arm in arms)
        hint = "set controller: {sync: handshake} and wire two outputs each way, or take ABB robots for both"
        return (Issue("post.controller", f"{names} cannot move together: {_ALONE}", hint=hint),)
    issues = []
    for arm in filter(speaks_krl, arms):
        wanted = _signals(problem, made, arm, together)
        missing = [signal for signal in wanted if problem.cell.controller.number(arm.name, signal) is None]
        if missing:
            got = (
                f"arm {arm.name} ({arm.robot}) is to use {', '.join(missing)}, which KRL knows by number only"
            )
            hint = f"state the numbers: controller: {{io: {{{arm.name}: {{{missing[0]}: 1}}}}}}, as they are"
            issues.append(
                Issue("post.signal", got, field=f"controller.io.{arm.name}", arm=arm.name, hint=hint)
            )
    return tuple(issues)


def _signals(problem: Problem, made: Sequence[Targets], arm: Arm, together: bool) -> list[str]:
    """Signals that an arm's program and its submit interpreter use: of the actions that it leads, and of its
    handshake."""
    order = [item.name for item in problem.cell.arms]
    out = [
        action.signal
        for targets in made
        if min(targets.arms, key=order.index) == arm.name
        for action in targets.actions
        if action.kind in ("on", "off")
    ]
    if together:
        own = problem.cell.controller.handshake.of(arm.name)
        out += [own.output, own.input, own.running, own.partner_running, own.move_enable]
    return list(dict.fromkeys(out))
