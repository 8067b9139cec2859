"""Result of a proof: the verdict rule by rule, arrays over the motion, and margins as text.

The margins are written into the headers of programs. `same_program` checks that a header changes nothing
else.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from planner.cell.clearance import LeastClearance
from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray, IntArray, lengths
from planner.issues import Issue, has_errors
from planner.languages.krl.reader.parser import without_comments
from planner.languages.rapid.reader.same_text import text_lines, text_words
from planner.languages.urscript.reader.words import without_comments as without_hash_comments
from planner.processes.forming.proof.state import Forming
from planner.processes.hotwire.proof.rules.wire import feed_speed
from planner.processes.hotwire.proof.wire_motion import Wire
from planner.proof.context import Context
from planner.proof.kinematics import arm_model
from planner.proof.kinematics.inverse_kinematics import singularity_distance
from planner.proof.replay.motion import differences


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


_SAMPLES_AT_ONCE = 65_536
"""Samples of a long motion that are worked on at once."""
_MOST_CURVE_POINTS = 6000
"""Points of a curve in a proof at most."""


def series(
    context: Context,
    wires: tuple[Wire, ...],
    forming: Forming | None,
    distances: Mapping[str, tuple[IntArray, LeastClearance | None]],
    wire_clearance: list[FloatArray],
) -> dict[str, Any]:
    """Names and units as they are: SI, per arm ``joints/<arm>`` (S, 6), ``speed/<arm>``,
    ``acceleration/<arm>``, ``tcp_speed/<arm>``, ``singular/<arm>`` (S,) [rad] off singular postures.

    The motion is thinned to a few thousand samples, extremes of speeds and accelerations kept within each.
    ``clearance/...`` over the looks of the clearance rule, ``own_clearance/...`` over those of the rule on
    arms and themselves, as ``distances`` has both; ``wire/<n>/...`` over the stations of each wire; straight
    ones have no stability, curvature and clearance of their own. ``gap/<n>/...`` over what two tools
    form: what they leave between them and what is wanted.
    """
    motion = context.motion
    stride = max(1, len(motion.time) // _MOST_CURVE_POINTS)
    rows = np.arange(0, len(motion.time), stride)
    out: dict[str, Any] = {"time": motion.time[rows], "label": motion.labels(rows)}
    for arm, q in motion.q.items():
        out[f"joints/{arm}"] = q[rows]
        # one axis at a time: a long motion has so many samples that a copy of all is felt
        for name, order in (("speed", 1), ("acceleration", 2)):
            axes = [
                _peaks(differences(motion.time, q[:, axis, None], order), rows) for axis in range(q.shape[1])
            ]
            out[f"{name}/{arm}"] = np.concatenate(axes, axis=1)
        place, way = motion.tcp[arm].place, np.zeros(len(motion.time))
        for begin in range(1, len(way), _SAMPLES_AT_ONCE):
            end = min(begin + _SAMPLES_AT_ONCE, len(way))
            step, spent = (np.diff(values[begin - 1 : end], axis=0) for values in (place, motion.time))
            way[begin:end] = lengths(step) / np.maximum(spent, 1e-6)
        out[f"tcp_speed/{arm}"] = _peaks(way[:, None], rows)[:, 0]
    for task in context.job.tasks:
        arm = task.arm.name
        q, machine = motion.q[arm], arm_model.machine_of(task.arm.data)
        parts = np.array_split(q, len(q) // _SAMPLES_AT_ONCE + 1)
        near = np.concatenate([singularity_distance(machine, part) for part in parts])
        out[f"singular/{arm}"] = np.minimum.reduceat(near, rows)
    out["targets/time"] = motion.time[motion.node_sample]
    out["targets/label"] = motion.node_label
    for name, (looks, found) in distances.items():
        if found is not None:
            out[f"{name}/time"] = motion.time[looks]
            out[f"{name}/distance"] = found.distance
            out[f"{name}/pair"] = np.array([" - ".join(pair) for pair in found.pair])
    for n, wire in enumerate(wires, 1):
        if wire.fault:
            continue
        out |= {
            f"wire/{n}/time": motion.time[wire.sample],
            f"wire/{n}/label": wire.labels,
            f"wire/{n}/points": wire.points,
            f"wire/{n}/depth": wire.depth,
            f"wire/{n}/feed": feed_speed(context, wire),
        }
        if wire.path is None:
            continue
        out |= {
            f"wire/{n}/stability": wire.path.min_eig,
            f"wire/{n}/curvature": np.linalg.norm(wire.path.curvature, axis=2).max(axis=1),
        }
        if len(wire_clearance) >= n:
            out[f"wire/{n}/clearance"] = wire_clearance[n - 1]
    for n, gap in enumerate(forming.opened if forming is not None else (), 1):
        some = np.unique(np.linspace(0, max(len(gap.knots) - 1, 0), _MOST_CURVE_POINTS).astype(np.int64))[
            : len(gap.knots)
        ]
        out |= {
            f"gap/{n}/time": motion.time[gap.track.rows[gap.knots[some]]],
            f"gap/{n}/got": gap.got[some],
            f"gap/{n}/low": gap.low[some] - gap.claim.tolerance,
            f"gap/{n}/high": gap.high[some] + gap.claim.tolerance,
        }
    return out


def _peaks(values: FloatArray, rows: IntArray) -> FloatArray:
    """Value of largest size within each stretch between rows."""
    if len(rows) == len(values):
        return values
    high = np.maximum.reduceat(values, rows, axis=0)
    low = np.minimum.reduceat(values, rows, axis=0)
    return np.asarray(np.where(high > -low, high, low))


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


def same_program(first: Mapping[str, str], second: Mapping[str, str]) -> bool:
    """Whether two sets of programs differ in comments and white space at most, file by file."""
    return first.keys() == second.keys() and all(_same(name, first[name], second[name]) for name in first)


def _same(name: str, first: str, second: str) -> bool:
    if PurePosixPath(name).suffix.lower() in (".src", ".dat"):
        return without_comments(first) == without_comments(second)
    if PurePosixPath(name).suffix.lower() == ".script":
        return without_hash_comments(first) == without_hash_comments(second)
    return text_lines(first) == text_lines(second) or text_words(first) == text_words(second)
