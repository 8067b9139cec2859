"""Two controllers' programs laid side by side: what happens between their meetings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from planner.problem import Problem
from planner.verify import handshake_text
from planner.verify.handshake_text import Reading, Sections
from planner.verify.steps import CallStep, MessageStep, MoveStep, SettingStep, Step


class Part(NamedTuple):
    """One stage: whether both arms move in it, the meeting it begins with, steps by arm, and the moves behind
    which the arms meet in it, by index."""

    together: bool
    ident: str
    steps: Mapping[str, tuple[Step, ...]]
    ends: tuple[int, ...]


def readings(
    problem: Problem, steps: Mapping[str, Sequence[Step]], sections: Mapping[str, Sequence[Sections]]
) -> dict[str, Reading]:
    """What the programs of the arms in ``steps`` do with the wires between their controllers."""
    own = problem.cell.controller.handshake
    return handshake_text.read(list(steps), steps, sections, wiring(problem), own.kind, own.timeout)


def wiring(problem: Problem) -> handshake_text.Wiring:
    """The wires between the controllers of the cell."""
    arms = [arm.name for arm in problem.cell.arms]
    own = problem.cell.controller.handshake
    return handshake_text.Wiring.of(own.wired(arms), arms, own.wired_running(arms))


def parts(found: Mapping[str, Reading], steps: Mapping[str, Sequence[Step]]) -> tuple[Part, ...]:
    """Intervals between meetings; those in a row in which both arms do nothing but move, as often, are one
    stage. None where the programs have different numbers of meetings."""
    out: list[Part] = []
    row: list[dict[str, list[Step]]] = []
    ends: list[int] = []
    intervals = handshake_text.intervals(found, steps)
    for number, interval in enumerate(intervals):
        counts = [sum(isinstance(step, MoveStep) for step in part) for part in interval.values()]
        together = len(counts) > 1 and all(counts)
        plain = len(set(counts)) == 1 and all(_plain(step) for part in interval.values() for step in part)
        if together and plain:
            row.append(interval)
            ends.append((ends[-1] if ends else -1) + counts[0])
            continue
        out += _joined(row, ends, number)
        row, ends = [], []
        whole = {arm: tuple(part) for arm, part in interval.items()}
        out.append(Part(together, f"meeting_{number}", whole, (min(counts) - 1,) if together else ()))
    return (*out, *_joined(row, ends, len(intervals)))


def _joined(row: Sequence[Mapping[str, Sequence[Step]]], ends: Sequence[int], behind: int) -> list[Part]:
    if not row:
        return []
    steps = {arm: tuple(step for interval in row for step in interval[arm]) for arm in row[0]}
    return [Part(True, f"meeting_{behind - len(row)}", steps, tuple(ends))]


def _plain(step: Step) -> bool:
    """Whether a step is a move, or nothing that needs the other arm to be at rest."""
    talks = isinstance(step, MessageStep) and not step.confirm
    return talks or isinstance(step, MoveStep | CallStep | SettingStep)
