"""Names of segments that programs cannot carry, found before anything is planned."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from typing import Final

from planner.claims import Claim
from planner.issues import Issue, TandemError
from planner.post.languages import speaks_krl, used
from planner.post.rapid_names import alike, procedure
from planner.problem import Problem
from planner.segments import Segment
from planner.targets import Targets

_OWN: Final = re.compile(
    r"main|operation_\d+|handshake\w*|block_\d+_\w+|meet_\d+|j_\w+|t_\w+|w_\w+|z_turn_\d+|z\d+[mu]m|v_entry|"
    r"load_block\w*|check_(cell|pose|true|stop)|base_frame|problem_digest|all_tasks"
)
"""Names of other things in RAPID programs."""


def refusals(problem: Problem, made: Sequence[Targets]) -> tuple[Issue, ...]:
    """Segments that programs cannot tell apart, that two operations of one setup have in common though
    something is claimed of them, and names that RAPID does not take (all ``post.name``). ``made``: the
    targets of each operation."""
    rapid = not all(map(speaks_krl, used(problem, made)))
    out: list[Issue] = []
    known: dict[str, Segment] = {}
    for number, targets in enumerate(made):
        field = f"operations.{number}"
        for segment in dict.fromkeys(targets.segment):
            other = known.setdefault(segment.key, segment)
            if other != segment:
                out.append(dataclasses.replace(alike(other, segment), field=field))
            elif rapid:
                out += _refused(segment, field)
    return (*out, *_shared(problem, made))


def _refused(segment: Segment, field: str) -> tuple[Issue, ...]:
    try:
        name = procedure(segment)
    except TandemError as error:
        return tuple(dataclasses.replace(issue, field=field) for issue in error.issues)
    if _OWN.fullmatch(name.lower()) is None:
        return ()
    what = f"segment {str(segment)!r} would be called {name}, as other things in RAPID programs are"
    return (Issue("post.name", what, field=field, hint="give it another kind or name"),)


def _shared(problem: Problem, made: Sequence[Targets]) -> list[Issue]:
    """Segments of two operations of one setup, which the proof would hold against the claims of both."""
    out: list[Issue] = []
    setups = [problem.setup_of(number).number for number in range(len(made))]
    for number, targets in enumerate(made):
        for before in range(number):
            if setups[before] != setups[number]:
                continue
            keys = {segment.key: segment for segment in dict.fromkeys(targets.segment)}
            claimed = _claimed(targets.claims) | _claimed(made[before].claims)
            both = [key for key in dict.fromkeys(s.key for s in made[before].segment) if key in keys]
            own = [keys[key] for key in both if key in claimed or keys[key].works]  # G-code is claimed whole
            if own:
                shown = str(own[0].at(""))
                names = [problem.operations[index].name for index in (before, number)]
                what = f"operations {names[0]!r} and {names[1]!r} both have the segment {shown!r}"
                hint = "do it once, give one of them another name, or give the second a setup of its own"
                out.append(Issue("post.name", what, field=f"operations.{number}", hint=hint))
    return out


def _claimed(claims: Sequence[Claim]) -> set[str]:
    """Keys of the segments of which something is claimed."""
    out: set[str] = set()
    for claim in claims:
        own = getattr(claim, "segments", None) or (getattr(claim, "segment", None),)
        out |= {segment.key for segment in own if isinstance(segment, Segment)}
    return out
