"""Names of RAPID's procedures with moves, after the segments that they run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from planner.issues import Issue, TandemError
from planner.post.layout import Part
from planner.post.rapid_format import NAME_LENGTH, identifier
from planner.segments import Segment, fold

LONG_KIND: Final = "__k"
"""Stands behind a kind that has underscores of its own, which else ends at the first one."""


def part_names(parts: Sequence[Part]) -> dict[Part, str]:
    """``cut_front`` for the first visit of ``cut/front``, ``cut_front__2`` for the second.

    Raises :class:`TandemError` (``post.name``).
    """
    visits: dict[str, int] = {}
    known: dict[str, Segment] = {}
    return {part: _name(part.segment, visits, known) for part in parts}


def alike(one: Segment, other: Segment) -> Issue:
    """Why programs cannot tell two segments apart."""
    message = (
        f"segments {str(one)!r} and {str(other)!r} would both be called {other.key!r} in the programs, which "
        "tell neither case nor runs of underscores and other signs apart"
    )
    return Issue("post.name", message, hint="give them names that differ in letters or digits")


def procedure(segment: Segment) -> str:
    """``cut_front`` for ``cut/front``: the label as a RAPID name, the same one for no two segments that
    differ in more than case and runs of underscores.

    A kind ends at the first underscore; ``__k`` stands behind one that has underscores of its own. Raises
    :class:`TandemError` (``post.name``).
    """
    name, kind = identifier(str(segment)), fold(segment.kind)
    if "_" not in kind:
        return name
    full = f"{kind}{LONG_KIND}{name[len(kind) :]}"
    if len(full) > NAME_LENGTH - 4:
        message = f"segment {str(segment)!r} would be called {full}, which is too long"
        raise TandemError(Issue("post.name", message, hint=f"allowed: {NAME_LENGTH - 4} characters"))
    return full


def _name(segment: Segment, visits: dict[str, int], known: dict[str, Segment]) -> str:
    name = procedure(segment)
    other = known.setdefault(name.lower(), segment)
    if other != segment:
        raise TandemError(alike(other, segment))
    visits[name] = visits.get(name, 0) + 1
    full = name if visits[name] == 1 else f"{name}__{visits[name]}"
    if len(full) > NAME_LENGTH:
        message = f"segment {str(segment)!r} comes {visits[name]} times, and {full} is too long for a name"
        raise TandemError(
            Issue("post.name", message, hint=f"shorten the label; allowed: {NAME_LENGTH} characters")
        )
    return full
