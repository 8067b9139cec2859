"""Result of a proof: the verdict rule by rule, arrays over the motion, and margins as text.

The margins are written into the headers of programs. :mod:`planner.proof.same_program` checks that a header
changes nothing else.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray
from planner.issues import Issue, has_errors


@dataclasses.dataclass(frozen=True)
class RuleResult:
    """One rule: its issue ``code``, what it says, and how the programs met it.

    ``worst`` and ``limit`` are in ``unit`` (as a person reads them), None for rules that only say yes or no.
    ``ran`` is False where an earlier fault left nothing to look at; such a rule has not passed. ``applies``
    is False where the programs have nothing that the rule asks about, for the reason that is in ``where``;
    such a rule has passed.
    """

    code: str
    title: str
    passed: bool
    worst: float | None = None
    limit: float | None = None
    unit: str = ""
    where: str = ""
    ran: bool = True
    applies: bool = True


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
    rules: tuple[RuleResult, ...] = dataclasses.field(repr=False)
    issues: tuple[Issue, ...]
    series: Mapping[str, Any] = dataclasses.field(repr=False)
    surfaces: tuple[CutFace, ...] = dataclasses.field(repr=False)
    part_obj: str = dataclasses.field(repr=False)

    @property
    def ok(self) -> bool:
        """Whether every rule ran and passed and no issue is an error."""
        return all(rule.passed for rule in self.rules) and not has_errors(self.issues)

    @property
    def tally(self) -> tuple[int, int, int]:
        """How many rules hold, of how many that the programs have something for, and how many others."""
        asked = [rule for rule in self.rules if rule.applies]
        return sum(rule.passed for rule in asked), len(asked), len(self.rules) - len(asked)

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


SHOWN_RESULTS: dict[str, str] = {
    "verify.clearance": "clearance",
    "verify.own_clearance": "own clearance",
    "verify.joint_limits": "joint limits",
    "verify.joint_speed": "joint speed",
    "verify.singularity": "singularity",
    "verify.surface": "cut surface",
}
"""Rules whose results a person at the robot is shown, with their names there."""


def text(proof: Proof) -> dict[str, str]:
    """Results of the rules that a person at the robot asks for: {name: "worst (limit)"}."""
    out = {}
    for code, name in SHOWN_RESULTS.items():
        rule = next((r for r in proof.rules if r.code == code), None)
        if rule is not None and rule.worst is not None:
            limit = "" if rule.limit is None else f", allowed {rule.limit:.4g} {rule.unit}"
            out[name] = f"{rule.worst:.4g} {rule.unit}{limit}"
    return out
