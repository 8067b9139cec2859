"""One type for everything that is wrong, the error that carries it, and whose fault a refusal is.

An :class:`Issue` is data. Programs compare its ``code``; people read its ``message``, which says
the subject, what was got, what is allowed and what to do. `given_wrong` tells faults of what was
given (exit code 2) from what cannot be planned (exit code 3).
"""

import dataclasses
from collections.abc import Callable, Collection, Iterable, Sequence
from enum import StrEnum
from typing import Any, Final, Literal, ParamSpec

from planner.issue_codes import row


class Severity(StrEnum):
    """How bad an issue is. Only an ``ERROR`` stops a program from being written."""

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


@dataclasses.dataclass(frozen=True)
class Remedy:
    """A change that was tried and helps: ``move_mm`` in the world of an obstacle, the stock or the base of an
    arm, ``home_deg``, an arm's posture at home, ``size_mm`` of a block, or ``clearance_mm`` and
    ``own_clearance_mm``, one of them or both; ``name`` is the obstacle's or the arm's, else that of the
    field."""

    what: Literal["obstacle", "stock", "base", "home", "size", "clearance"]
    name: str
    move_mm: tuple[float, float, float] | None = None
    home_deg: tuple[float, ...] | None = None
    size_mm: tuple[float, ...] | None = None
    clearance_mm: float | None = None
    own_clearance_mm: float | None = None


@dataclasses.dataclass(frozen=True)
class Issue:
    """One finding.

    ``value`` and ``limit`` are in ``unit`` (mm, deg, s ... as a person reads them). ``index`` is the
    target's index, ``time`` is in seconds on the job's clock, ``bodies`` names a joint or a pair of bodies.
    ``remedy`` is what the hint says as data, where a change was tried.
    ``accepted`` is of what is an error unless the problem accepts it by name: False until that is looked at
    (:func:`judged`), True where the problem does.
    Raises ``KeyError`` when ``code`` is not in the table of codes (:func:`planner.issue_codes.row`).
    """

    code: str
    message: str
    severity: Severity = Severity.ERROR
    file: str | None = None
    line: int | None = None
    field: str | None = None
    arm: str | None = None
    index: int | None = None
    target: str | None = None
    time: float | None = None
    bodies: tuple[str, ...] = ()
    value: float | None = None
    limit: float | None = None
    unit: str | None = None
    hint: str | None = None
    count: int = 1
    remedy: Remedy | None = None
    accepted: bool | None = None

    def __post_init__(self) -> None:
        row(self.code)

    def to_dict(self) -> dict[str, Any]:
        """The issue as plain data for JSON, without the fields that are unset."""
        data = dataclasses.asdict(self)
        plain = {k: float(v) if isinstance(v, float) else v for k, v in data.items()}  # NumPy's floats too
        return {k: v for k, v in plain.items() if v is not None and v != () and not (k == "count" and v == 1)}

    @staticmethod
    def from_dict(data: dict[str, Any]) -> "Issue":
        """The inverse of :meth:`to_dict`."""
        known = dict(data)
        known["severity"] = Severity(known.get("severity", "error"))
        known["bodies"] = tuple(known.get("bodies", ()))
        if (remedy := known.get("remedy")) is not None:
            plain: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in remedy.items()}
            known["remedy"] = Remedy(**plain)
        return Issue(**known)

    def __str__(self) -> str:
        where = [self.file] if self.file else []
        if self.line is not None:
            where.append(f"line {self.line}")
        if self.field:
            where.append(self.field)
        place = f"{', '.join(where)}: " if where else ""
        many = f" ({self.count} times)" if self.count > 1 else ""
        hint = f"; {self.hint}" if self.hint else ""
        accepted = " accepted by the problem:" if self.accepted else ""
        return f"{self.severity.value} [{self.code}]{accepted} {place}{self.message}{many}{hint}"


class TandemError(Exception):
    """Work that cannot go on: the issues that say why, and what was reached before, if anything."""

    def __init__(self, issues: Issue | Sequence[Issue], partial: object | None = None) -> None:
        self.issues: tuple[Issue, ...] = (issues,) if isinstance(issues, Issue) else tuple(issues)
        self.partial = partial
        super().__init__("\n".join(str(issue) for issue in self.issues))


_Fields = ParamSpec("_Fields")


def _error_of(issue: Callable[_Fields, Issue]) -> Callable[_Fields, TandemError]:
    def error(*fields: _Fields.args, **named: _Fields.kwargs) -> TandemError:
        return TandemError(issue(*fields, **named))

    return error


refusal: Final = _error_of(Issue)
"""Creates the error of one issue. Takes the fields of an :class:`Issue`, with their types."""


def has_errors(issues: Iterable[Issue]) -> bool:
    """Whether any issue is an error."""
    return any(issue.severity is Severity.ERROR for issue in issues)


def judged(issues: Iterable[Issue], accept: Collection[str]) -> tuple[Issue, ...]:
    """The issues; those that are errors unless accepted are errors now, with how to accept them, or accepted
    where ``accept`` has their codes. Raises ``ValueError`` for one that nobody may accept."""
    return tuple(_judge(issue, accept) for issue in issues)


def _judge(issue: Issue, accept: Collection[str]) -> Issue:
    if issue.accepted is None:
        return issue
    if not row(issue.code).accepts:
        raise ValueError(f"{issue.code} is not in the table of what a problem may accept")
    if issue.code in accept:
        return dataclasses.replace(issue, severity=Severity.WARNING, accepted=True)
    how = f"where it is known and wanted, accept it in the problem: accept: [{issue.code}]"
    hint = f"{issue.hint}; {how}" if issue.hint else how
    return dataclasses.replace(issue, severity=Severity.ERROR, accepted=None, hint=hint)


def accepted(issues: Iterable[Issue]) -> tuple[str, ...]:
    """Codes of the issues that a problem accepts, in order of the alphabet."""
    return tuple(sorted({issue.code for issue in issues if issue.accepted}))


def aggregate(issues: Iterable[Issue]) -> tuple[Issue, ...]:
    """Issues of the same code, severity, arm, field, file and bodies as one, which counts them and keeps the
    worst.

    The kept issue is the first one (its index, time and message), unless a later one has a value farther
    beyond the limit. Order of first appearance is kept.
    """
    groups: dict[tuple[object, ...], list[Issue]] = {}
    for issue in issues:
        key = (issue.code, issue.severity, issue.arm, issue.field, issue.file, issue.bodies)
        groups.setdefault(key, []).append(issue)
    return tuple(_merge(group) for group in groups.values())


def _merge(group: list[Issue]) -> Issue:
    count = sum(issue.count for issue in group)
    first = group[0]
    if len(group) == 1:
        return first
    worst = max(group, key=_excess)
    message = worst.message
    if first.index is not None:
        message += f" [{count} targets, first at {first.index}]"
    return dataclasses.replace(worst, message=message, count=count)


def _excess(issue: Issue) -> float:
    if issue.value is None or issue.limit is None:
        return 0.0
    return abs(issue.value - issue.limit)


def given_wrong(issues: Iterable[Issue]) -> bool:
    """Whether all errors are faults of what was given (exit code 2), not of what is feasible (3)."""
    return all(row(issue.code).given for issue in issues if issue.severity is Severity.ERROR)


def with_remedy(issue: Issue) -> Issue:
    """The issue with what its code says to do, where it does not say so itself."""
    remedy = row(issue.code).remedy
    return issue if issue.hint or remedy is None else dataclasses.replace(issue, hint=remedy)
