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
    """Result of one rule.

    Attributes:
        code: Code of its issues.
        title: Requirement in words.
        passed: Whether the programs meet it.
        worst: Worst value in ``unit``, None for rules that only say yes or no.
        limit: Limit in ``unit``, None for rules that only say yes or no.
        unit: Unit in which a person reads both.
        where: Where the worst value is, or why the rule does not apply.
        ran: Whether the rule ran. It does not run if an earlier fault leaves nothing to examine. Then it has
            not passed.
        applies: Whether the programs contain something that the rule examines. If not, the rule has passed.
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
    """The simulated cut of one segment against the expected face, in the stock frame [m].

    Attributes:
        segment: The segment.
        points: Points (M, 3) [m] on the expected face.
        deviation: Deviations (M,) [m], positive where material is left, negative where too much is cut, NaN
            where the tool did not pass.
        area: Area (M,) [m^2] of the face that each point represents.
        tolerance: Tolerance [m], the greatest one if it is not the same everywhere.
        share: Fraction of the face within tolerance.
        wanted_share: Required fraction.
        rms: Root mean square [m] of the deviations.
        largest: Largest deviation [m].
        end_error: Error [m] of the position of the ends of a wire.
        share_with_error: Fraction of the face within tolerance with this error.
        speed: Speed (M,) [m/s] of the wire across itself where it passed.
        allowed: Tolerance (M,) [m] at each point if it is not the same everywhere, else empty.
        more: Number of further segments that cut the face, too.
        unreached: Distance [m] from the face that the tool must keep where it is too large to reach the face.
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
        """Name in reports: the segment, and the number of further segments that cut the face."""
        return f"{self.segment} and {self.more} more" if self.more else str(self.segment)


@dataclasses.dataclass(frozen=True)
class Proof:
    """The verdict of a proof.

    Attributes:
        problem_digest: Digest of the problem.
        rules: Results of all rules.
        issues: All issues.
        series: Arrays over the replayed motion, by name, for the report.
        surfaces: Simulated faces.
        part_obj: Simulated part, as the text of an OBJ file.
    """

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
    def rule_counts(self) -> tuple[int, int, int]:
        """Number of rules that hold, of rules that apply, and of rules that do not apply."""
        applicable = [rule for rule in self.rules if rule.applies]
        return sum(rule.passed for rule in applicable), len(applicable), len(self.rules) - len(applicable)

    @property
    def is_read(self) -> bool:
        """Whether all texts were read completely, so that the rules on tasks ran."""
        return self.rule("verify.task_list").ran

    def rule(self, code: str) -> RuleResult:
        """Return the result of one rule.

        Raises:
            KeyError: There is no such rule.
        """
        for rule in self.rules:
            if rule.code == code:
                return rule
        raise KeyError(code)


SHOWN_RESULT_NAMES: dict[str, str] = {
    "verify.clearance": "clearance",
    "verify.own_clearance": "own clearance",
    "verify.joint_limits": "joint limits",
    "verify.joint_speed": "joint speed",
    "verify.singularity": "singularity",
    "verify.surface": "cut surface",
}
"""Rules whose results are shown to a person at the robot, with their names there."""


def shown_results(proof: Proof) -> dict[str, str]:
    """Return the results that a person at the robot needs: {name: "worst (limit)"}."""
    out = {}
    for code, name in SHOWN_RESULT_NAMES.items():
        rule = next((r for r in proof.rules if r.code == code), None)
        if rule is not None and rule.worst is not None:
            limit = "" if rule.limit is None else f", allowed {rule.limit:.4g} {rule.unit}"
            out[name] = f"{rule.worst:.4g} {rule.unit}{limit}"
    return out
