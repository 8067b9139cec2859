"""What the report draws of a motion, on one clock: from the proof's replay or, without one, the plan.

Names that are read from ``Proof.series``: ``time`` (T,) [s]; per arm ``q/<arm>``, ``speed/<arm>``,
``acceleration/<arm>`` (T, 6) [rad, rad/s, rad/s^2]; ``clearance`` (T,) [m] with ``clearance_pair`` (T,)
names of the closest pair; ``clearance_time`` (T',) where it has a clock of its own. All are optional.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner import catalogue
from planner.catalogue import RobotData
from planner.plan import Plan
from planner.problem import Problem
from planner.report.charts import Band
from planner.targets import segment_kind
from planner.verify.result import Proof

FloatArray = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class ArmMotion:
    """One arm over time (T,): serial joint angles, speeds, accelerations (T, 6); the margins [rad] (T,)."""

    robot: RobotData
    time: FloatArray
    q: FloatArray
    speed: FloatArray
    acceleration: FloatArray | None

    @property
    def limit_margin(self) -> FloatArray:
        """Least distance (T,) [rad] to a joint limit."""
        return self.robot.limit_margin(self.q)

    @property
    def wrist_angle(self) -> FloatArray:
        """Angle (T,) [rad] of axis 5 from the posture where axes 4 and 6 are in line."""
        opw = self.robot.opw
        theta = opw.signs[4] * self.q[:, 4] - opw.offsets[4]
        return np.asarray(np.abs(np.arctan2(np.sin(theta), np.abs(np.cos(theta)))))


@dataclasses.dataclass(frozen=True)
class Clearance:
    """Least distance (T,) [m] of anything to anything, and between what."""

    time: FloatArray
    distance: FloatArray
    pair: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Feed:
    """Speed (N,) [m/s] on the way to each target with its window; ``time`` (N,) [s]."""

    time: FloatArray
    speed: FloatArray
    lower: FloatArray
    upper: FloatArray


@dataclasses.dataclass(frozen=True)
class Motion:
    """All that is drawn over time; ``source`` says where it comes from."""

    arms: Mapping[str, ArmMotion]
    clearance: Clearance | None
    feed: Feed
    bands: tuple[Band, ...]
    source: str


def motion(problem: Problem, plan: Plan, proof: Proof | None) -> Motion:
    """The motion of a plan, operations one after the other."""
    starts = operation_starts(plan)
    arms, source = _proven(problem, proof), "replayed from the programs' text"
    if not arms:
        arms, source = _planned(problem, plan, starts), "the plan's targets"
    bands = [band for op, t0 in zip(plan.operations, starts, strict=True) for band in _bands(op, t0)]
    return Motion(arms, _clearance(proof), _feed(plan, starts), tuple(bands), source)


def operation_starts(plan: Plan) -> list[float]:
    """The time [s] at which each operation's clock starts when they run one after the other."""
    lengths = [float(op.time[-1]) if len(op.time) else 0.0 for op in plan.operations]
    return [float(sum(lengths[:i])) for i in range(len(lengths))]


def _proven(problem: Problem, proof: Proof | None) -> dict[str, ArmMotion]:
    series: Mapping[str, Any] = proof.series if proof is not None else {}
    if "time" not in series:
        return {}
    time = np.asarray(series["time"], dtype=np.float64)
    out = {}
    for arm in problem.cell.arms:
        q = series.get(f"q/{arm.name}")
        if q is None or len(q) != len(time) or len(time) < 2:
            continue
        given = series.get(f"speed/{arm.name}")
        speed = np.gradient(q, time, axis=0) if given is None else np.asarray(given)
        out[arm.name] = ArmMotion(
            catalogue.robot(arm.robot), time, np.asarray(q), speed, series.get(f"acceleration/{arm.name}")
        )
    return out


def _planned(problem: Problem, plan: Plan, starts: list[float]) -> dict[str, ArmMotion]:
    out = {}
    for arm in problem.cell.arms:
        used = [(op, t) for op, t in zip(plan.operations, starts, strict=True) if arm.name in op.q]
        if not used or sum(len(op.time) for op, _ in used) < 2:
            continue
        time = np.concatenate([op.time + t for op, t in used])
        q = np.concatenate([op.q[arm.name] for op, _ in used])
        step = np.maximum(np.diff(time), 1e-9)
        speed = np.concatenate([np.zeros((1, 6)), np.diff(q, axis=0) / step[:, None]])
        speed[np.concatenate([[True], np.diff(time) < 1e-6])] = 0.0
        out[arm.name] = ArmMotion(catalogue.robot(arm.robot), time, q, speed, None)
    return out


def _clearance(proof: Proof | None) -> Clearance | None:
    series: Mapping[str, Any] = proof.series if proof is not None else {}
    distance = series.get("clearance")
    time = series.get("clearance_time", series.get("time"))
    if distance is None or time is None or len(distance) != len(time):
        return None
    pair = series.get("clearance_pair")
    names = (
        tuple(_pair(p) for p in pair) if pair is not None and len(pair) == len(time) else ("",) * len(time)
    )
    return Clearance(np.asarray(time, dtype=np.float64), np.asarray(distance, dtype=np.float64), names)


def _pair(value: Any) -> str:
    return value if isinstance(value, str) else " – ".join(str(v) for v in value)


def _feed(plan: Plan, starts: list[float]) -> Feed:
    rows = []
    for op, start in zip(plan.operations, starts, strict=True):
        step = np.diff(op.time, prepend=op.time[:1])
        moved = (step > 1e-9) & (op.targets.travel > 1e-9)
        speed = np.where(moved, op.targets.travel / np.maximum(step, 1e-9), np.nan)
        rows.append(np.stack([op.time + start, speed, op.targets.feed_min, op.targets.feed]))
    joined = np.concatenate(rows, axis=1) if rows else np.zeros((4, 0))
    return Feed(*joined)


def _bands(op: Any, start: float) -> list[Band]:
    labels, time = op.targets.segment, op.time + start
    out: list[Band] = []
    for i in range(1, len(labels)):
        if out and out[-1].name == labels[i]:
            out[-1] = dataclasses.replace(out[-1], end=float(time[i]))
        else:
            out.append(Band(float(time[i - 1]), float(time[i]), labels[i], segment_kind(labels[i])))
    return out
