"""Converts a URScript program to a sequence of operations on the wires between two controllers."""

import dataclasses
from collections.abc import Collection, Sequence
from typing import Final, Literal

from planner.programs.steps import (
    CheckStep,
    MessageStep,
    MoveStep,
    ProgramStep,
    RunningStep,
    SignalStep,
    WaitStep,
    WatchStep,
)

MoveKind = Literal["set", "wait", "look", "check", "ask", "run", "watch", "go", "done"]
MIN_SETTLING_TIME_S: Final = 1.0
"""Minimum time [s] for which a program waits before its running wire rises at its start.

Chosen: one second settles wires, monitoring threads and the other program's statements.
"""


@dataclasses.dataclass(frozen=True, slots=True)
class WireOperation:
    """The next operation of a program.

    "set": its line gets ``value``. "wait": until it reads the other program's line so. "look": until it
    reads the other program's running wire so. "check": it ends unless it reads that line so, the other
    program as running, and its own running wire is ``own_level``. "ask": until the operator answers. "run":
    its running wire gets ``value``; ``is_slow``: long after everything before. "watch": a monitoring thread
    starts or ends. "go" and "done" enclose its work in the interval ``value`` between two meetings.

    Attributes:
        kind: Kind of operation.
        value: Level or interval, by kind.
        own_level: Required level of its own running wire in a "check".
        is_slow: Whether a "run" comes after a long wait.
        line: Index into the steps of the program.
    """

    kind: MoveKind
    value: int = 0
    own_level: bool = True
    is_slow: bool = False
    line: int = 0


def wire_operations(
    steps: Sequence[ProgramStep],
    interval: Sequence[int],
    drives: Collection[str],
    reads: Collection[str],
    watches: Collection[str],
) -> tuple[list[WireOperation], list[int]]:
    """Return the operations of a URScript program on its wires, and the interval of each.

    Work is what moves the arm or switches something on.

    Args:
        steps: Steps of the program.
        interval: Interval of each step.
        drives: Outputs to the other program, in lower case.
        reads: Inputs from there, in lower case.
        watches: Inputs of the other program's running wire, in lower case.
    """
    out: list[WireOperation] = []
    blocks: list[int] = []
    current_interval = 0

    def add(move: WireOperation) -> None:
        if move.kind != "go" and out and out[-1].kind == "go":
            out.append(dataclasses.replace(out[-1], kind="done"))
            blocks.append(blocks[-1])
        out.append(move)
        blocks.append(current_interval)

    for i, (step, number) in enumerate(zip(steps, interval, strict=True)):
        current_interval = number
        match step:
            case SignalStep() if step.signal.lower() in drives:
                add(WireOperation("set", int(step.value == 1.0), line=i))
            case WaitStep() if step.signal.lower() in watches:
                add(WireOperation("look", int(step.value == 1.0), line=i))
            case WaitStep() if step.signal.lower() in reads:
                add(WireOperation("wait", int(step.value == 1.0), line=i))
            case CheckStep():
                add(WireOperation("check", step.value, own_level=step.own_level, line=i))
            case RunningStep():
                add(
                    WireOperation(
                        "run", int(step.on), is_slow=step.on and step.waited >= MIN_SETTLING_TIME_S, line=i
                    )
                )
            case WatchStep():
                add(WireOperation("watch", int(step.on), line=i))
            case MessageStep() if step.confirm:
                add(WireOperation("ask", line=i))
            case MoveStep() | SignalStep():
                works = isinstance(step, MoveStep) or step.value != 0.0
                if works and not (out and out[-1].kind == "go" and out[-1].value == number):
                    add(WireOperation("go", number, line=i))
    if out and out[-1].kind == "go":
        out.append(dataclasses.replace(out[-1], kind="done"))
        blocks.append(blocks[-1])
    return out, blocks
