"""Signals of a controller by their numbers."""

from collections.abc import Mapping
from typing import NamedTuple

from planner.problem import Arm, Problem


def controller_signals(problem: Problem, arm: Arm) -> "NumberedSignals":
    """Return the names of inputs and outputs of a KUKA or UR controller by number, as the cell states them.

    A name is an input if a handshake or an operation reads it, else an output. If two outputs or two inputs
    share a number, its name consists of both names, because it is not known which one is meant.

    Args:
        problem: The problem.
        arm: Arm of the controller.
    """
    controller = problem.cell.controller
    handshake_signals = controller.handshake.of(arm.name)
    input_names = (
        {handshake_signals.input.lower(), handshake_signals.partner_running.lower()}
        if controller.sync == "handshake"
        else set()
    )
    process_inputs = (getattr(operation, "ok_signal", None) for operation in problem.operations)
    input_names |= {name.lower() for name in process_inputs if isinstance(name, str)}
    names_by_number: tuple[dict[int, str], dict[int, str]] = ({}, {})
    for name, number in controller.io.get(arm.name, {}).items():
        # False selects the table of outputs, True that of inputs
        table = names_by_number[name.lower() in input_names]
        table[number] = f"{table[number]} and {name}" if number in table else name
    return NumberedSignals(*names_by_number)


class NumberedSignals(NamedTuple):
    """Names of a controller's outputs and inputs by number."""

    outputs: Mapping[int, str]
    inputs: Mapping[int, str]
