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
    """One operation of a program on the wires.

    - "set": The program's line gets ``value``.
    - "wait": The program waits until it reads the level ``value`` of the other program's line.
    - "look": The program waits until it reads the level ``value`` of the other program's running wire.
    - "check": The program ends unless it reads ``value`` of the other program's line and 1 of its running
      wire, and its own running wire is ``own_level``.
    - "ask": The program waits until the operator answers.
    - "run": The program's running wire gets ``value``.
    - "watch": A monitoring thread starts (``value`` 1) or ends (0).
    - "go", "done": They enclose the program's work in the interval ``value`` between two meetings.

    Attributes:
        kind: Kind of operation.
        value: Level or number of the interval, by kind.
        own_level: Required level of the program's own running wire in a "check".
        is_slow: Whether a "run" comes after a wait that is so long that all wires have settled.
        line: Index of the step among the steps of the program.
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
    """Return the operations of a URScript program on its wires, and the interval of each operation.

    Moves, and outputs that are switched on, are work. Consecutive work of one interval becomes one "go" and
    one "done". Steps without effect on the wires are left out: messages without a question, outputs that are
    switched off, and all steps of other kinds.

    Args:
        steps: Steps of the program.
        interval: Interval between two meetings of each step.
        drives: Names of outputs to the other program, in lower case.
        reads: Names of inputs from the other program, in lower case.
        watches: Names of inputs of the other program's running wire, in lower case.
    """
    out: list[WireOperation] = []
    blocks: list[int] = []
    current_interval = 0

    def add(move: WireOperation) -> None:
        """Append an operation. If the last operation begins work ("go"), the end of this work precedes it."""
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
