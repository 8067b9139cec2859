"""Names of RAPID's procedures with moves, after the segments that they run."""

from __future__ import annotations

from collections.abc import Sequence

from planner.issues import Issue, TandemError
from planner.post.layout import Part
from planner.post.rapid_format import NAME_LENGTH, identifier


def part_names(parts: Sequence[Part]) -> dict[Part, str]:
    """``cut_front`` for the first visit of ``cut/front``, ``cut_front__2`` for the second.

    Raises :class:`TandemError` (``post.name``).
    """
    visits: dict[str, int] = {}
    labels: dict[str, str] = {}
    return {part: _name(part.label, visits, labels) for part in parts}


def _name(label: str, visits: dict[str, int], labels: dict[str, str]) -> str:
    name = identifier(label)
    other = labels.setdefault(name.lower(), label)
    if other != label:
        message = f"segments {other!r} and {label!r} would both be called {name}"
        raise TandemError(
            Issue("post.name", message, hint="give them names that differ in letters or digits")
        )
    visits[name] = visits.get(name, 0) + 1
    full = name if visits[name] == 1 else f"{name}__{visits[name]}"
    if len(full) > NAME_LENGTH:
        message = f"segment {label!r} comes {visits[name]} times, and {full} is too long for a name"
        raise TandemError(
            Issue("post.name", message, hint=f"shorten the label; allowed: {NAME_LENGTH} characters")
        )
    return full
