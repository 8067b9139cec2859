"""What the service says no to: an HTTP status and the issues that say why."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from planner.issues import Issue


class RefusedError(Exception):
    """A request that is refused; ``issues`` carry code and field."""

    def __init__(
        self, status: int, issues: Issue | Sequence[Issue], headers: Mapping[str, str] | None = None
    ) -> None:
        self.status = status
        self.issues = (issues,) if isinstance(issues, Issue) else tuple(issues)
        self.headers = dict(headers or {})
        super().__init__("; ".join(issue.message for issue in self.issues))

    @property
    def body(self) -> dict[str, Any]:
        """The answer as JSON."""
        return {"issues": [plain(issue) for issue in self.issues]}


def plain(issue: Issue) -> dict[str, Any]:
    """The issue as JSON has it: numbers that are not finite are left out."""
    data = issue.to_dict()
    return {k: v for k, v in data.items() if not isinstance(v, float) or math.isfinite(v)}


def unknown_job(job: str) -> RefusedError:
    """404."""
    return RefusedError(404, Issue("service.unknown_job", f"job {job[:40]!r}: there is none; list the jobs"))


def too_large(what: str, limit_mb: float, field: str | None = None) -> RefusedError:
    """413."""
    message = f"{what} is larger than the {limit_mb:g} MB that this service takes; send less, or fewer facets"
    return RefusedError(413, Issue("service.too_large", message, field=field, limit=limit_mb, unit="MB"))
