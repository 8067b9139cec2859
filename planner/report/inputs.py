"""What the report draws of a motion, on one clock: from the proof's replay or, without one, the plan.

Names that are read from ``Proof.series``, all optional: ``time`` (T,) [s] and ``label`` (T,) of segments; per
arm ``joints/<arm>``, ``speed/<arm>``, ``acceleration/<arm>`` (T, 6) [rad, rad/s, rad/s^2];
``clearance/time``, ``clearance/distance`` [m] and ``clearance/pair`` (K,); per wire n ``wire/<n>/time``,
``label``, ``feed`` [m/s], ``clearance`` [m], ``curvature`` [1/m] and ``stability`` [-], each (W,);
per gap n of two tools ``gap/<n>/time``, ``got``, ``low``, ``high`` [m], each (G,).
"""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner import catalogue
from planner.catalogue import RobotData
from planner.claims import CutsSurface, FeedWindow, WireJoins
from planner.plans import Plan
from planner.problem import Problem
from planner.report.charts import Band
from planner.segments import Segment
from planner.units import MM
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
class WireMotion:
    """One wire over time (W,): clearance [m], curvature and its limit [1/m], least eigenvalue."""

    time: FloatArray
    clearance: FloatArray | None
    curvature: FloatArray | None
    stability: FloatArray | None
    max_curvature: float | None


@dataclasses.dataclass(frozen=True)
class Gap:
    """The gap [m] that two tools leave over time (G,), and the least and the most that is allowed."""

    time: FloatArray
    got: FloatArray
    low: FloatArray
    high: FloatArray


@dataclasses.dataclass(frozen=True)
class Motion:
    """All that is drawn over time; ``source`` says where it comes from.

    ``work``: from when to when [s] the targets' segments run; at other times arms move alone, by their
    joints. Without any all of it is work.
    """

    arms: Mapping[str, ArmMotion]
    clearance: Clearance | None
    feed: Feed
    wires: tuple[WireMotion, ...]
    bands: tuple[Band, ...]
    source: str
    work: tuple[tuple[float, float], ...] = ()
    gap: Gap | None = None

    def wrist(self, arm: str) -> float:
        """Least wrist angle [rad] of an arm in the segments of the targets."""
        moved = self.arms[arm]
        inside = np.zeros(len(moved.time), dtype=bool)
        for start, end in self.work:
            inside |= (moved.time >= start) & (moved.time <= end)
        return float(np.min(moved.wrist_angle[inside if inside.any() else slice(None)]))


def motion(problem: Problem, plan: Plan, proof: Proof | None) -> Motion:
    """The motion of a plan, operations one after the other."""
    series: Mapping[str, Any] = proof.series if proof is not None else {}
    starts = operation_starts(plan)
    arms = _proven(problem, series)
    if arms:
        bands = _bands([Segment.read(str(v)) for v in series.get("label", ())], np.asarray(series["time"]))
        feed = _proven_feed(plan, series)
        source = "replayed from the programs' text, from home to home"
        named = {segment.key for op in plan.operations for segment in op.targets.segment}
        work = tuple((band.start, band.end) for band in bands if band.name in named)
        return Motion(arms, _clearance(series), feed, _wires(plan, series), bands, source, work, _gap(series))
    rows = [_bands(op.targets.segment, op.time + t) for op, t in zip(plan.operations, starts, strict=True)]
    bands = tuple(band for row in rows for band in row)
    shown = _planned(problem, plan, starts)
    return Motion(shown, None, _feed(plan, starts), (), bands, "the plan's targets")


def kerf_range(cuts: Sequence[CutsSurface], windows: Sequence[FeedWindow]) -> str:
    """Widths [mm] of the slots at the speeds that the feed windows of their segments allow, as text."""
    window = {w.segment: w for w in windows}
    widths: list[float] = []
    for cut in cuts:
        table = cut.kerf.speed
        found = window.get(cut.segment)
        lower, upper = (
            (found.lower, found.upper) if found is not None else (float(table[0]), float(table[-1]))
        )
        inside = table[(table > lower) & (table < upper)]
        widths += cut.kerf.at(np.concatenate([[lower], inside, [upper]])).tolist()
    low, high = min(widths) / MM, max(widths) / MM
    return f"{low:.3g}" if high - low < 5e-4 else f"{low:.2f}–{high:.2f}"


def kerf_shown(
    cuts: Sequence[CutsSurface], windows: Sequence[FeedWindow], proof: Proof | None
) -> tuple[str, str]:
    """What the kerf is called, and its range [mm]: of the cut, at the speeds with which the proof saw the
    wire pass the faces, or without a proof that of the feeds allowed."""
    passed = {face.segment.key: face.speed for face in (proof.surfaces if proof is not None else ())}
    speeds = [passed.get(cut.segment.key, np.zeros(0)) for cut in cuts]
    widths = [cut.kerf.at(speed[np.isfinite(speed)]) / MM for cut, speed in zip(cuts, speeds, strict=True)]
    if not widths or not all(len(width) for width in widths):
        return "kerf at the feeds allowed", kerf_range(cuts, windows)
    low, high = min(float(w.min()) for w in widths), max(float(w.max()) for w in widths)
    return "kerf of the cut", f"{low:.3g}" if high - low < 5e-4 else f"{low:.2f}–{high:.2f}"


def operation_starts(plan: Plan) -> list[float]:
    """The time [s] at which each operation's clock starts when they run one after the other."""
    lengths = [float(op.time[-1]) if len(op.time) else 0.0 for op in plan.operations]
    return [float(sum(lengths[:i])) for i in range(len(lengths))]


def _proven(problem: Problem, series: Mapping[str, Any]) -> dict[str, ArmMotion]:
    out = {}
    for arm in problem.cell.arms:
        q = series.get(f"joints/{arm.name}")
        if q is None or len(q) < 2:
            continue
        time = np.asarray(series["time"], dtype=np.float64)
        given = series.get(f"speed/{arm.name}")
        speed = np.gradient(q, time, axis=0) if given is None else np.asarray(given)
        robot = catalogue.robot(arm.robot)
        out[arm.name] = ArmMotion(robot, time, np.asarray(q), speed, series.get(f"acceleration/{arm.name}"))
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


def _clearance(series: Mapping[str, Any]) -> Clearance | None:
    time, distance = series.get("clearance/time"), series.get("clearance/distance")
    if time is None or distance is None or not np.isfinite(distance).any():
        return None
    pair = series.get("clearance/pair", [""] * len(time))
    names = tuple(str(p).replace(" - ", " – ") for p in pair)
    return Clearance(np.asarray(time, dtype=np.float64), np.asarray(distance, dtype=np.float64), names)


def _numbers(series: Mapping[str, Any], what: str) -> list[int]:
    """Numbers n of the wires that have ``wire/<n>/<what>``."""
    found = (re.fullmatch(rf"wire/(\d+)/{what}", name) for name in series)
    return sorted(int(match.group(1)) for match in found if match)


def _gap(series: Mapping[str, Any]) -> Gap | None:
    """All gaps one after the other; between two of them there is none."""
    found = (re.fullmatch(r"gap/(\d+)/time", name) for name in series)
    numbers = sorted(int(match.group(1)) for match in found if match)
    rows = [
        np.stack([np.append(series[f"gap/{n}/{what}"], np.nan) for what in ("time", "got", "low", "high")])
        for n in numbers
        if len(series[f"gap/{n}/time"])
    ]
    return Gap(*np.concatenate(rows, axis=1)) if rows else None


def _wires(plan: Plan, series: Mapping[str, Any]) -> tuple[WireMotion, ...]:
    """The bent wires of the proof, with the limits of the plan's claims, which are in the same order."""
    limits = [
        c.max_curvature for op in plan.operations for c in op.targets.claims if isinstance(c, WireJoins)
    ]
    bent = [n for n in _numbers(series, "time") if f"wire/{n}/curvature" in series]
    out = []
    for i, n in enumerate(bent):
        time = series[f"wire/{n}/time"]
        if len(time) > 1:
            clear, bend, stable = (
                series.get(f"wire/{n}/{k}") for k in ("clearance", "curvature", "stability")
            )
            limit = limits[i] if len(bent) == len(limits) else None
            out.append(WireMotion(np.asarray(time), clear, bend, stable, limit))
    return tuple(out)


def _proven_feed(plan: Plan, series: Mapping[str, Any]) -> Feed:
    """Speeds of the wires' fastest points inside the stock, with the windows that the claims state."""
    windows = {
        c.segment.key: c for op in plan.operations for c in op.targets.claims if isinstance(c, FeedWindow)
    }
    rows = []
    for n in _numbers(series, "feed"):
        labels = [str(v) for v in series[f"wire/{n}/label"]]
        lower = np.array([windows[v].lower if v in windows else np.nan for v in labels])
        upper = np.array([windows[v].upper if v in windows else np.nan for v in labels])
        rows.append(np.stack([series[f"wire/{n}/time"], series[f"wire/{n}/feed"], lower, upper]))
    if not rows or not np.isfinite(np.concatenate(rows, axis=1)[1]).any():
        return _feed(plan, operation_starts(plan))
    return Feed(*np.concatenate(rows, axis=1))


def _feed(plan: Plan, starts: list[float]) -> Feed:
    rows = []
    for op, start in zip(plan.operations, starts, strict=True):
        step = np.diff(op.time, prepend=op.time[:1])
        moved = (step > 1e-9) & (op.targets.travel > 1e-9)
        speed = np.where(moved, op.targets.travel / np.maximum(step, 1e-9), np.nan)
        rows.append(np.stack([op.time + start, speed, op.targets.feed_min, op.targets.feed]))
    joined = np.concatenate(rows, axis=1) if rows else np.zeros((4, 0))
    return Feed(*joined)


def _bands(segments: Sequence[Segment], time: FloatArray) -> tuple[Band, ...]:
    """Runs of one segment of T; it belongs to the way to its instant."""
    count = min(len(segments), len(time))
    first = [i for i in range(1, count) if i == 1 or segments[i] != segments[i - 1]]
    return tuple(
        Band(float(time[a - 1]), float(time[b - 1]), str(segments[a]), segments[a].kind)
        for a, b in itertools.pairwise([*first, count])
    )
