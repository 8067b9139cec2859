"""Result of reading an upload, as the process that reads passes it to the service."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from planner.issues import Issue


@dataclasses.dataclass(frozen=True)
class Examined:
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
