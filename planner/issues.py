"""Issues, the error that carries them, and the classification of refusals.

An :class:`Issue` is data. Programs compare its ``code``; people read its ``message``, which states the
subject, the value, the allowed range and the remedy. :func:`is_input_error` separates faults of the input
(exit code 2) from problems that cannot be planned (exit code 3).
"""

import dataclasses
from collections.abc import Callable, Collection, Iterable, Sequence
from enum import StrEnum
from typing import Any, Final, Literal, ParamSpec

from planner.issue_codes import lookup_code


class Severity(StrEnum):
    """Severity of an issue. Only an ``ERROR`` prevents a program from being written."""

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


@dataclasses.dataclass(frozen=True)
class Remedy:
    """A change of the problem that was tried and removes an issue. Values are None if they do not change.

    Attributes:
        what: What to change.
        name: Name of the obstacle or arm, else that of the field.
        move_mm: Translation (3,) in the world of an obstacle, the stock or the base of an arm [mm].
        home_deg: New joint values of an arm at home [deg].
        size_mm: New size of the stock [mm].
        clearance_mm: New clearance [mm], alone or together with ``own_clearance_mm``.
        own_clearance_mm: New clearance between links and tool of the same arm [mm].
    """

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

    Attributes:
        code: Code in the table of issue codes (:func:`planner.issue_codes.lookup_code`).
        message: Text for people.
        severity: Severity.
        file: File at fault.
        line: Line in the file.
        field: Path of the field in the problem.
        arm: Name of the arm.
        index: Index of the target.
        target: Name of the target.
        time: Time on the clock of the job [s].
        bodies: Name of the joint, or names of the two bodies.
        value: Value found, in ``unit``.
        limit: Allowed limit, in ``unit``.
        unit: Unit as people read it (mm, deg, s, ...).
        hint: Remedy as text.
        count: Number of merged issues.
        remedy: The hint as data, if a change was tried.
        accepted: None for ordinary issues. False for an error that the problem may accept and that has not
            been compared with its list of acceptances (:func:`apply_acceptances`). True if the problem
            accepts it.

    Raises:
        KeyError: If ``code`` is not in the table of codes.
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
        lookup_code(self.code)

    def to_dict(self) -> dict[str, Any]:
        """Return the issue as plain data for JSON, without unset fields."""
        data = dataclasses.asdict(self)
        data = {k: float(v) if isinstance(v, float) else v for k, v in data.items()}  # also NumPy's floats
        return {k: v for k, v in data.items() if v is not None and v != () and not (k == "count" and v == 1)}

    @staticmethod
    def from_dict(data: dict[str, Any]) -> "Issue":
        """Create an issue from the data of :meth:`to_dict`."""
        fields = dict(data)
        fields["severity"] = Severity(fields.get("severity", "error"))
        fields["bodies"] = tuple(fields.get("bodies", ()))
        remedy = fields.get("remedy")
        if remedy is not None:
            remedy_fields: dict[str, Any] = {
                k: tuple(v) if isinstance(v, list) else v for k, v in remedy.items()
            }
            fields["remedy"] = Remedy(**remedy_fields)
        return Issue(**fields)

    def __str__(self) -> str:
        """Return one line for people: severity, code, place, message, count and hint."""
        location_parts = [self.file] if self.file else []
        if self.line is not None:
            location_parts.append(f"line {self.line}")
        if self.field:
            location_parts.append(self.field)
        location = f"{', '.join(location_parts)}: " if location_parts else ""
        repeats = f" ({self.count} times)" if self.count > 1 else ""
        hint = f"; {self.hint}" if self.hint else ""
        accepted = " accepted by the problem:" if self.accepted else ""
        return f"{self.severity.value} [{self.code}]{accepted} {location}{self.message}{repeats}{hint}"


class TandemError(Exception):
    """Error that carries the issues because of which work cannot continue.

    Attributes:
        issues: The reasons.
        partial: Result computed before the error, if the function that raises it states one.
    """

    def __init__(self, issues: Issue | Sequence[Issue], partial: object | None = None) -> None:
        self.issues: tuple[Issue, ...] = (issues,) if isinstance(issues, Issue) else tuple(issues)
        self.partial = partial
        super().__init__("\n".join(str(issue) for issue in self.issues))


_Fields = ParamSpec("_Fields")
"""Parameters of :class:`Issue`."""


def _make_error_factory(issue: Callable[_Fields, Issue]) -> Callable[_Fields, TandemError]:
    """Return a function with the parameters of ``issue`` that returns an error with this one issue."""

    def error(*fields: _Fields.args, **named: _Fields.kwargs) -> TandemError:
        return TandemError(issue(*fields, **named))

    return error


issue_error: Final = _make_error_factory(Issue)
"""Creates a ``TandemError`` with one issue. Takes the fields of an :class:`Issue`, with their types."""


def has_errors(issues: Iterable[Issue]) -> bool:
    """Whether any issue is an error."""
    return any(issue.severity is Severity.ERROR for issue in issues)


def apply_acceptances(issues: Iterable[Issue], accept: Collection[str]) -> tuple[Issue, ...]:
    """Return issues with the acceptances of a problem applied to them.

    Issues whose ``accepted`` is not None become accepted warnings if ``accept`` has their code. Otherwise
    they become errors whose hint says how to accept them. Other issues are returned unchanged.

    Args:
        issues: Issues to compare.
        accept: Codes that the problem accepts.

    Raises:
        ValueError: If ``accepted`` of an issue is not None, but no problem may accept its code.
    """
    return tuple(_apply_acceptance(issue, accept) for issue in issues)


def _apply_acceptance(issue: Issue, accept: Collection[str]) -> Issue:
    """Return one issue with the acceptances of a problem applied, as :func:`apply_acceptances` does."""
    if issue.accepted is None:
        return issue
    if not lookup_code(issue.code).acceptance:
        raise ValueError(f"{issue.code} is not in the table of what a problem may accept")
    if issue.code in accept:
        return dataclasses.replace(issue, severity=Severity.WARNING, accepted=True)
    acceptance_hint = f"if this is known and intended, accept it in the problem: accept: [{issue.code}]"
    hint = f"{issue.hint}; {acceptance_hint}" if issue.hint else acceptance_hint
    return dataclasses.replace(issue, severity=Severity.ERROR, accepted=None, hint=hint)


def accepted_codes(issues: Iterable[Issue]) -> tuple[str, ...]:
    """Return the codes of the issues that a problem accepts, in alphabetical order."""
    return tuple(sorted({issue.code for issue in issues if issue.accepted}))


def aggregate(issues: Iterable[Issue]) -> tuple[Issue, ...]:
    """Merge issues of equal code, severity, arm, field, file and bodies into one that counts them.

    The merged issue is the one of its group whose value differs most from its limit, the first of equal ones.
    Its message states the index of the first issue. Groups keep the order of first appearance.
    """
    groups: dict[tuple[object, ...], list[Issue]] = {}
    for issue in issues:
        key = (issue.code, issue.severity, issue.arm, issue.field, issue.file, issue.bodies)
        groups.setdefault(key, []).append(issue)
    return tuple(_merge(group) for group in groups.values())


def _merge(group: list[Issue]) -> Issue:
    """Return the issue of a group with the largest distance from its limit, with the count of the group."""
    count = sum(issue.count for issue in group)
    first = group[0]
    if len(group) == 1:
        return first
    worst = max(group, key=_limit_excess)
    message = worst.message
    if first.index is not None:
        message += f" [{count} targets, first at {first.index}]"
    return dataclasses.replace(worst, message=message, count=count)


def _limit_excess(issue: Issue) -> float:
    """Return the distance of an issue's value from its limit, 0 if one of them is unknown."""
    if issue.value is None or issue.limit is None:
        return 0.0
    return abs(issue.value - issue.limit)


def is_input_error(issues: Iterable[Issue]) -> bool:
    """Whether all errors are faults of the input (exit code 2) rather than of feasibility (exit code 3)."""
    return all(lookup_code(issue.code).is_input_error for issue in issues if issue.severity is Severity.ERROR)


def with_remedy(issue: Issue) -> Issue:
    """Return the issue with the remedy of its code as hint, if it has no hint of its own."""
    remedy = lookup_code(issue.code).remedy
    return issue if issue.hint or remedy is None else dataclasses.replace(issue, hint=remedy)
