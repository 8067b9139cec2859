"""Names of segments that programs cannot carry, found before anything is planned."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from planner.issues import Issue, TandemError
from planner.post.languages import speaks_krl, used
from planner.post.rapid_names import alike, procedure
from planner.problem import Problem
from planner.segments import Segment
from planner.targets import Targets


def refusals(problem: Problem, made: Sequence[Targets]) -> tuple[Issue, ...]:
    """Segments that programs cannot tell apart, that two operations have in common, or whose names RAPID does
    not take (all ``post.name``). ``made``: the targets of each operation."""
    out: list[Issue] = []
    rapid = not all(map(speaks_krl, used(problem, made)))
    known: dict[str, Segment] = {}
    for number, targets in enumerate(made):
        field = f"operations.{number}"
        for segment in dict.fromkeys(targets.segment):
            other = known.setdefault(segment.key, segment)
            if other != segment:
                out.append(alike(other, segment, field))
            elif rapid:
                out += _refused(segment, field)
    return tuple(out)


def _refused(segment: Segment, field: str) -> tuple[Issue, ...]:
    try:
        procedure(segment)
    except TandemError as error:
        return tuple(dataclasses.replace(issue, field=field) for issue in error.issues)
    return ()
