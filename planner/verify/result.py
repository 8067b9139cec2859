"""What a proof gives back."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.issues import Issue, has_errors
from planner.segments import Segment

FloatArray = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class RuleResult:
    """One rule: its issue ``code``, what it says, and how the programs met it.

    ``worst`` and ``limit`` are in ``unit`` (as a person reads them), None for rules that only say yes or no.
    ``ran`` is False where an earlier fault left nothing to look at; such a rule has not passed.
    """

    code: str
    title: str
    passed: bool
    worst: float | None = None
    limit: float | None = None
    unit: str = ""
    where: str = ""
    ran: bool = True


@dataclasses.dataclass(frozen=True)
class CutFace:
    """The simulated cut of one segment against the wanted face, in the stock frame [m].

    ``points`` (M, 3) lie on the wanted face, ``deviation`` (M,) is positive where material is left standing
    and negative where too much is cut, NaN where the wire did not pass. ``area`` (M,) [m^2] is each point's
    share of the face; ``speed`` (M,) [m/s] that of the wire across itself where it passed. ``allowed`` (M,)
    [m] where the tolerance is not the same everywhere, ``tolerance`` being its greatest; else empty.
    ``more``: how many other segments cut it too; ``unreached`` [m]: how far off a tool of that size stays at
    least where it fits nowhere nearer.
    """

    segment: Segment
    points: FloatArray
    deviation: FloatArray
    area: FloatArray
    tolerance: float
    share: float
    wanted_share: float
    rms: float
    largest: float
    end_error: float = 0.0
    share_with_error: float = float("nan")
    speed: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(0))
    allowed: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(0))
    more: int = 0
    unreached: float = 0.0

    @property
    def title(self) -> str:
        """What people call it: the segment, and how many more cut it."""
        return f"{self.segment} and {self.more} more" if self.more else str(self.segment)


@dataclasses.dataclass(frozen=True)
class Proof:
    """The verdict. ``series`` are arrays over the replayed motion, by name, for the report; ``part_obj`` is
    the simulated part."""

    problem_digest: str
    rules: tuple[RuleResult, ...]
    issues: tuple[Issue, ...]
    series: Mapping[str, Any]
    surfaces: tuple[CutFace, ...]
    part_obj: str

    @property
    def ok(self) -> bool:
        """Whether every rule ran and passed and no issue is an error."""
        return all(rule.passed for rule in self.rules) and not has_errors(self.issues)

    @property
    def read(self) -> bool:
        """Whether all of the texts was read: rules on the tasks side by side ran."""
        return self.rule("verify.task_list").ran

    def rule(self, code: str) -> RuleResult:
        """The result of one rule; raises ``KeyError``."""
        for rule in self.rules:
            if rule.code == code:
                return rule
        raise KeyError(code)
