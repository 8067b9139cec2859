"""Findings of a rule while it examines programs: its issues, and the worst value with its location."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.issues import Issue
from planner.programs.stages import TaskText
from planner.programs.steps import ProgramStep
from planner.proof import rule
from planner.proof.context import Context
from planner.proof.rule import Measure, RuleOutcome, mm


class Findings:
    """Issues of one rule in the order in which they are found, and its worst value.

    The worst value is that of the values that the rule examines.

    Attributes:
        code: Code of the rule.
        context: The proof.
        issues: What is wrong.
        worst: The worst value, in SI units.
        excess: How far it is beyond its limit, if it was noted by :meth:`note_excess`.
        limit: What is allowed there, in SI units.
        where: Where the worst value is.
        measured: Whether a value was noted.
    """

    def __init__(self, code: str, context: Context, worst: float = -np.inf) -> None:
        self.code, self.context = code, context
        self.issues: list[Issue] = []
        self.worst, self.excess = worst, -np.inf
        self.limit: float | None = None
        self.where = ""
        self.measured = False

    # ---- issues ----

    def add(self, message: str, measure: Measure | None = None, **fields: Any) -> None:
        """Add an issue. ``fields`` are further fields of :class:`planner.issues.Issue`."""
        self.issues.append(rule.measured_issue(self.code, message, measure, **fields))

    def add_at_step(
        self, message: str, task: TaskText, step: ProgramStep | None, hint: str | None = None
    ) -> None:
        """Add an issue about a step of a task."""
        self.issues.append(rule.step_issue(self.code, message, task, step, hint))

    def add_at_node(self, message: str, arm: str, node: int | np.integer) -> None:
        """Add an issue about a target of the replayed motion."""
        self.issues.append(rule.node_issue(self.code, message, self.context.motion, arm, int(node)))

    def add_at_sample(
        self,
        message: str,
        arm: str,
        sample: int | np.integer,
        measure: Measure | None = None,
        bodies: tuple[str, ...] = (),
    ) -> None:
        """Add an issue about an instant of the replayed motion."""
        motion = self.context.motion
        issue = rule.sample_issue(self.code, message, motion, arm, int(sample), measure)
        self.issues.append(dataclasses.replace(issue, bodies=bodies))

    # ---- the worst value ----

    def note_highest(self, value: float, where: object = "", limit: float | None = None) -> None:
        """Note a value if it is higher than the worst one so far. NaN counts as the worst of all."""
        if value > self.worst or np.isnan(value):
            self._note(value, where, limit)

    def note_lowest(self, value: float, where: object = "", limit: float | None = None) -> None:
        """Note a value if it is lower than the worst one so far. NaN counts as the worst of all."""
        if value < self.worst or np.isnan(value):
            self._note(value, where, limit)

    def note_excess(self, values: FloatArray | float, limit: float, where: object) -> None:
        """Note the highest of some values if it exceeds its limit by more than the worst one so far.

        NaN counts as the worst of all.
        """
        value = float(np.max(values))
        if value - limit > self.excess or np.isnan(value):
            self.excess = value - limit
            self._note(self.excess + limit, where, limit)

    def _note(self, value: float, where: object, limit: float | None) -> None:
        """Record the worst value with its location and limit."""
        self.worst, self.limit, self.where = float(value), limit, str(where)
        self.measured = True

    # ---- the outcome ----

    def outcome(
        self,
        show: Callable[[float], float] = float,
        unit: str = "",
        limit: float | None = None,
        nothing: str = "",
    ) -> RuleOutcome:
        """Return the outcome.

        Args:
            show: Converts a value from SI units to ``unit``.
            unit: Unit in which a person reads the worst value and the limit.
            limit: What is allowed, if it is the same everywhere.
            nothing: Why no value was examined, if none was.
        """
        if nothing and not self.measured:
            return RuleOutcome(tuple(self.issues), nothing=nothing)
        limit = self.limit if limit is None else limit
        allowed = None if limit is None else show(limit)
        return RuleOutcome(tuple(self.issues), show(self.worst), allowed, unit, self.where)

    def excess_outcome(self, nothing: str) -> RuleOutcome:
        """Return the outcome of a rule that notes lengths by :meth:`note_excess`."""
        if self.limit is None:
            return RuleOutcome(tuple(self.issues), nothing=nothing)
        limit = mm(self.limit)
        return RuleOutcome(tuple(self.issues), mm(self.excess) + limit, limit, "mm", self.where)

    def outcome_without_value(self, nothing: str = "", where: str = "") -> RuleOutcome:
        """Return the outcome of a rule that examines no value."""
        return RuleOutcome(tuple(self.issues), nothing=nothing, where=where)


def to_degrees(angle: float) -> float:
    """Convert radians to degrees for messages."""
    return float(np.rad2deg(angle))


def to_percent(fraction: float) -> float:
    """Convert a fraction to per cent for messages."""
    return 100.0 * fraction


def measure_in_mm(value: float, limit: float) -> tuple[float, float, str]:
    """Return measured and allowed value in mm, from metres."""
    return mm(float(value)), mm(float(limit)), "mm"


def measure_in_degrees(value: float, limit: float) -> tuple[float, float, str]:
    """Return measured and allowed value in degrees, from radians."""
    return to_degrees(value), to_degrees(limit), "deg"


def measure_in_percent(value: float, limit: float) -> tuple[float, float, str]:
    """Return measured and allowed value in per cent, from fractions."""
    return to_percent(value), to_percent(limit), "%"


def format_point_mm(point: FloatArray) -> str:
    """Format a point [m] in mm for messages."""
    return ", ".join(f"{mm(x):.1f}" for x in point)


def evenly_spaced_rows(flags: BoolArray, count: int) -> IntArray:
    """Return about ``count`` indices at which flags are set, evenly spaced among all such indices."""
    rows = np.flatnonzero(flags)
    return rows[:: max(1, len(rows) // count)]
