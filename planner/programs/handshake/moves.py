"""What a program of URScript does with the wires between two controllers, as a row of moves."""

import dataclasses
from collections.abc import Collection, Sequence
from typing import Final, Literal

from planner.programs.steps import (
    CheckStep,
    MessageStep,
    MoveStep,
    RunningStep,
    SignalStep,
    Step,
    WaitStep,
    WatchStep,
)

MoveKind = Literal["set", "wait", "look", "check", "ask", "run", "watch", "go", "done"]
SLOW: Final = 1.0
"""How long [s] a program has to stand before its running wire rises at its start."""


@dataclasses.dataclass(frozen=True, slots=True)
class Move:
    """What a program does next. "set": its line gets ``value``; "wait" until it reads the other one's line
    so; "look" until it reads that one's running wire so; "check": it ends unless it reads that line so, the
    other one as running, and its own running wire is ``own``; "ask": until somebody answers; "run": its
    running wire gets ``value``, ``slow``: long after all before; "watch": a thread begins or ends; "go" and
    "done" enclose its work in the interval ``value`` between two meetings. ``line``: an index into its steps.
    """

    kind: MoveKind
    value: int = 0
    own: bool = True
    slow: bool = False
    line: int = 0


def moves(
    steps: Sequence[Step],
    interval: Sequence[int],
    drives: Collection[str],
    reads: Collection[str],
    watches: Collection[str],
) -> tuple[list[Move], list[int]]:
    """What a program of URScript does with its wires, and the interval of each move. ``drives``, ``reads``,
    ``watches``: its output to the other one, the input from there, and that of the other one's running wire,
    in lower case. Work is what moves the arm or switches something on."""
    out: list[Move] = []
    blocks: list[int] = []
    at = 0

    def add(move: Move) -> None:
        if move.kind != "go" and out and out[-1].kind == "go":
            out.append(dataclasses.replace(out[-1], kind="done"))
            blocks.append(blocks[-1])
        out.append(move)
        blocks.append(at)

    for i, (step, number) in enumerate(zip(steps, interval, strict=True)):
        at = number
        match step:
            case SignalStep() if step.signal.lower() in drives:
                add(Move("set", int(step.value == 1.0), line=i))
            case WaitStep() if step.signal.lower() in watches:
                add(Move("look", int(step.value == 1.0), line=i))
            case WaitStep() if step.signal.lower() in reads:
                add(Move("wait", int(step.value == 1.0), line=i))
            case CheckStep():
                add(Move("check", step.value, own=step.own, line=i))
            case RunningStep():
                add(Move("run", int(step.on), slow=step.on and step.waited >= SLOW, line=i))
            case WatchStep():
                add(Move("watch", int(step.on), line=i))
            case MessageStep() if step.confirm:
                add(Move("ask", line=i))
            case MoveStep() | SignalStep():
                works = isinstance(step, MoveStep) or step.value != 0.0
                if works and not (out and out[-1].kind == "go" and out[-1].value == number):
                    add(Move("go", number, line=i))
    if out and out[-1].kind == "go":
        out.append(dataclasses.replace(out[-1], kind="done"))
        blocks.append(blocks[-1])
    return out, blocks
