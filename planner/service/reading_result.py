"""Options and result of reading an upload, which the service and the process that reads exchange."""

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

from planner.issues import Issue


@dataclasses.dataclass(frozen=True)
class ReadingOptions:
    """What is computed from an uploaded problem, and which of its fields are replaced before.

    Attributes:
        reach: Compute targets and test reach.
        draw: Return shapes to draw.
        targets: Approximate number of targets to sample for a quick check of reach, or None for all.
        cell: Arguments of a drawing of the cell, or None.
        fields: New values by field path, or None.
    """

    reach: bool = False
    draw: bool = False
    targets: int | None = None
    cell: Mapping[str, Any] | None = None
    fields: Mapping[str, Any] | None = None


PROBLEM_ONLY: Final = ReadingOptions()
"""Options of reading a problem unchanged, without further computation."""


@dataclasses.dataclass(frozen=True)
class ReadingResult:
    """Result of reading an upload.

    An upload that cannot be read has only ``issues``, which contain errors.

    Attributes:
        issues: Errors and warnings.
        name: Name of the problem.
        digest: Digest of the problem and its files.
        processes: Names of the processes of its operations.
        text: Problem file in a form that does not depend on other documents; empty if it cannot be read.
        files: SHA-256 of each file, by its name in ``text``.
        summary: Facts of the problem, for lists.
        shapes: Geometry to draw.
        looked_at: Result of the check of reach, if requested.
        cell: Drawing of the cell, if requested.
    """

    issues: tuple[Issue, ...]
    name: str = ""
    digest: str = ""
    processes: tuple[str, ...] = ()
    text: str = ""
    files: Mapping[str, str] = dataclasses.field(default_factory=dict)
    summary: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    shapes: tuple[Mapping[str, Any], ...] = ()
    looked_at: Mapping[str, Any] | None = None
    cell: Mapping[str, Any] | None = None

    @property
    def readable(self) -> bool:
        """Whether the problem can be planned, as far as its file states."""
        return bool(self.text)
