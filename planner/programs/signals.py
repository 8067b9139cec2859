"""Signals of a controller by their numbers."""

from collections.abc import Mapping
from typing import NamedTuple

from planner.problem import Arm, Problem


def krl_signals(problem: Problem, arm: Arm) -> "Signals":
    """Names of the inputs and outputs of a KUKA or UR controller by number, as the cell states them; inputs
    are those of a handshake and those that operations wait for. A number that two names of one kind share has
    both for a name: which one is meant is not known."""
    controller = problem.cell.controller
    own = controller.handshake.of(arm.name)
    reads = {own.input.lower(), own.partner_running.lower()} if controller.sync == "handshake" else set()
    waits = (getattr(operation, "ok_signal", None) for operation in problem.operations)
    reads |= {name.lower() for name in waits if isinstance(name, str)}
    tables: tuple[dict[int, str], dict[int, str]] = ({}, {})
    for name, value in controller.io.get(arm.name, {}).items():
        table = tables[name.lower() in reads]
        table[value] = f"{table[value]} and {name}" if value in table else name
    return Signals(*tables)


class Signals(NamedTuple):
    """Names of a controller's outputs and inputs by number."""

    outputs: Mapping[int, str]
    inputs: Mapping[int, str]
