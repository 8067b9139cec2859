"""What a rule finds while it examines programs: its issues, and the worst value with its place."""

from collections.abc import Callable
from typing import Any

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.issues import Issue
from planner.programs.stages import TaskText
from planner.programs.steps import Step
from planner.proof import rule
from planner.proof.context import Context
from planner.proof.rule import Measure, Outcome, mm


class Findings:
    """Issues of one rule in the order in which they are found, and the worst of the values that it examines.

    Attributes:
        code: Code of the rule.
        context: The proof.
        issues: What is wrong.
        worst: The worst value, in SI units.
        excess: How far it is beyond its limit, if it was noted by :meth:`beyond`.
        limit: What is allowed there, in SI units.
        where: Where the worst value is.
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
        """Add an issue. ``fields`` are others of its fields."""
        self.issues.append(rule.issue(self.code, message, measure, **fields))

    def at_step(self, message: str, task: TaskText, step: Step | None, hint: str | None = None) -> None:
        """Add an issue about a step of a task."""
        self.issues.append(rule.at_step(self.code, message, task, step, hint))

    def at_node(self, message: str, arm: str, node: int | np.integer) -> None:
        """Add an issue about a target of the replayed motion."""
        self.issues.append(rule.at_node(self.code, message, self.context.motion, arm, int(node)))

    def at_sample(
        self,
        message: str,
        arm: str,
        sample: int | np.integer,
        measure: Measure | None = None,
        bodies: tuple[str, ...] = (),
    ) -> None:
        """Add an issue about an instant of the replayed motion."""
        motion = self.context.motion
        self.issues.append(rule.at_sample(self.code, message, motion, arm, int(sample), measure, bodies))

    # ---- the worst value ----

    def highest(self, value: float, where: object = "", limit: float | None = None) -> None:
        """Note a value if it is higher than the worst one so far. NaN counts as the worst of all."""
        if value > self.worst or np.isnan(value):
            self._note(value, where, limit)

    def lowest(self, value: float, where: object = "", limit: float | None = None) -> None:
        """Note a value if it is lower than the worst one so far. NaN counts as the worst of all."""
        if value < self.worst or np.isnan(value):
            self._note(value, where, limit)

    def beyond(self, values: FloatArray | float, limit: float, where: object) -> None:
        """Note the highest of some values if it exceeds its limit by more than the worst one so far.

        NaN counts as the worst of all.
        """
        value = float(np.max(values))
        if value - limit > self.excess or np.isnan(value):
            self.excess = value - limit
            self._note(self.excess + limit, where, limit)

    def _note(self, value: float, where: object, limit: float | None) -> None:
        self.worst, self.limit, self.where = float(value), limit, str(where)
        self.measured = True

    # ---- the outcome ----

    def outcome(
        self,
        show: Callable[[float], float] = float,
        unit: str = "",
        limit: float | None = None,
        nothing: str = "",
    ) -> Outcome:
        """Return the outcome.

        Args:
            show: Converts a value from SI units to ``unit``.
            unit: Unit in which a person reads the worst value and the limit.
            limit: What is allowed, if it is the same everywhere.
            nothing: Why no value was examined, if there is none.
        """
        if nothing and not self.measured:
            return Outcome(tuple(self.issues), nothing=nothing)
        limit = self.limit if limit is None else limit
        allowed = None if limit is None else show(limit)
        return Outcome(tuple(self.issues), show(self.worst), allowed, unit, self.where)

    def outcome_beyond(self, nothing: str) -> Outcome:
        """Return the outcome of a rule that notes lengths by :meth:`beyond`."""
        if self.limit is None:
            return Outcome(tuple(self.issues), nothing=nothing)
        limit = mm(self.limit)
        return Outcome(tuple(self.issues), mm(self.excess) + limit, limit, "mm", self.where)

    def outcome_without_value(self, nothing: str = "", where: str = "") -> Outcome:
        """Return the outcome of a rule that examines no value."""
        return Outcome(tuple(self.issues), nothing=nothing, where=where)


def degrees(angle: float) -> float:
    """Radians as degrees for messages."""
    return float(np.rad2deg(angle))


def percent(share: float) -> float:
    """A share in per cent for messages."""
    return 100.0 * share


def in_mm(value: float, limit: float) -> tuple[float, float, str]:
    """What is measured and allowed, both in metres, as a person reads them."""
    return mm(float(value)), mm(float(limit)), "mm"


def in_degrees(value: float, limit: float) -> tuple[float, float, str]:
    """What is measured and allowed, both in radians, as a person reads them."""
    return degrees(value), degrees(limit), "deg"


def in_percent(value: float, limit: float) -> tuple[float, float, str]:
    """What is measured and allowed, both as shares, as a person reads them."""
    return percent(value), percent(limit), "%"


def coordinates(point: FloatArray) -> str:
    """Coordinates of a point [m] in mm for messages."""
    return ", ".join(f"{mm(x):.1f}" for x in point)


def evenly(flags: BoolArray, count: int) -> IntArray:
    """Rows at which flags are set, about ``count`` of them, evenly chosen."""
    rows = np.flatnonzero(flags)
    return rows[:: max(1, len(rows) // count)]
