"""Names that a controller takes for the same."""

from __future__ import annotations

from planner.claims.segments import Segment
from planner.issues import Issue


def alike(one: Segment, other: Segment) -> Issue:
    """Why programs cannot tell two segments apart."""
    message = (
        f"segments {str(one)!r} and {str(other)!r} would both be called {other.key!r} in the programs, which "
        "tell neither case nor runs of underscores and other signs apart"
    )
    return Issue("post.name", message, hint="give them names that differ in letters or digits")
