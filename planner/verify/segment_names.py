"""Which segment a program says that it runs: read back from the names of procedures and from KRL's marks."""

from __future__ import annotations

import functools
import re
from typing import Final

from planner.segments import Segment

_AGAIN: Final = re.compile(r"__[0-9]+$")
"""Ends the name of a procedure that is not the first one of its segment."""
_LONG_KIND: Final = "__k"
"""Stands behind a kind that has underscores of its own, which else ends at the first one."""


@functools.lru_cache(maxsize=65536)
def said(procedure: str) -> Segment:
    """The segment of a RAPID procedure, or of the label that stands in a KRL comment; in lower case.

    ``cut_front`` and ``cut_front__2``, its second visit, are the cut of ``front``, ``cut_front_in`` the way
    in to it, and ``cut_way_in_on`` the cut of ``way_in``. Labels have a ``/`` behind the kind, or no name.
    """
    name = procedure.strip().lower()
    if "/" in name:
        kind, _, rest = name.partition("/")
        return _phased(kind, rest)
    name = _AGAIN.sub("", name)
    kind, long, rest = name.partition(_LONG_KIND)
    if long and rest[:1] in ("", "_"):
        return _phased(kind, rest[1:])
    kind, _, rest = name.partition("_")
    return _phased(kind, rest)


def _phased(kind: str, rest: str) -> Segment:
    """A kind and what stands behind it: a name, and perhaps a word for the phase; each run of signs that are
    neither letters nor digits counts as one underscore."""
    for word in ("in", "out", "on"):
        before = rest.removesuffix(f"_{word}")
        if before and before != rest:
            return Segment(
                _plain(kind), _plain(before), "in" if word == "in" else "out" if word == "out" else ""
            )
    return Segment(_plain(kind), _plain(rest))


def _plain(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", text).strip("_")
