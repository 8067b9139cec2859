"""Signals of a problem that two different things would switch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from planner.issues import Issue
from planner.problem import Cell

USES: Final = {"elastic_wire": "the power of a hot wire", "straight_wire": "the power of a hot wire"}
"""What the ``signal`` of operations switches, by process."""
SPINDLE: Final = "a spindle"


def shared(cell: Cell, operations: Sequence[Any]) -> list[Issue]:
    """Issues (``problem.signal``) for names that stand for two things on one controller, capitals or not:
    what switches a wire would switch a spindle too, or be taken for an answer of the other controller."""
    own = cell.controller.sync == "handshake"
    order = [arm.name for arm in cell.arms]
    known: dict[tuple[str, str], str] = {}
    out: list[Issue] = []

    def add(controller: str, name: str, use: str, field: str) -> None:
        other = known.setdefault((controller, name.lower()), use)
        if other != use:
            what = f"{name} would switch {use} and is {other} already; one signal has one use"
            out.append(Issue("problem.signal", what, field=field, hint="name another signal, as it is wired"))

    if own and any(len(operation.arms) > 1 for operation in operations):
        for arm in order:
            names = cell.controller.handshake.of(arm)
            add(arm, names.output, "the output to the other controller", "cell.controller.handshake.signals")
            add(arm, names.input, "the input from the other controller", "cell.controller.handshake.signals")
    for number, operation in enumerate(operations):
        lead = min(operation.arms, key=lambda arm: order.index(arm) if arm in order else len(order))
        controller = lead if own else ""
        if name := getattr(operation, "signal", None):
            add(controller, name, USES.get(operation.process, SPINDLE), f"operations.{number}.signal")
        die = getattr(operation, "die", None)
        if die is not None and die.holder == "sinking":
            add(controller, die.signal, "a blank holder", f"operations.{number}.die.signal")
    return out
