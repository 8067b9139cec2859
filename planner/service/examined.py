"""What is known of an upload once it was read."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from planner.issues import Issue


@dataclasses.dataclass(frozen=True)
class Examined:
    """What is known of an upload. Where it can be read: ``text``, the problem as it stands alone, ``files``
    {name in it: SHA-256}, its ``name``, ``digest``, ``processes`` and ``summary``; else errors alone."""

    issues: tuple[Issue, ...]
    name: str = ""
    digest: str = ""
    processes: tuple[str, ...] = ()
    text: str = ""
    files: Mapping[str, str] = dataclasses.field(default_factory=dict)
    summary: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    shapes: tuple[Mapping[str, Any], ...] = ()

    @property
    def readable(self) -> bool:
        """Whether the problem can be planned, as far as its file says."""
        return bool(self.text)
