"""Charts of a motion on one clock: feed, clearances, margins, joint angles and speeds, and limits.

Drawn from the proof's replay or, without one, from the plan. Names that are read from
``Proof.series``, all optional: ``time`` (T,) [s] and ``label`` (T,) of segments; per arm
``joints/<arm>``, ``speed/<arm>``, ``acceleration/<arm>`` (T, 6) [rad, rad/s, rad/s^2];
``clearance/time``, ``clearance/distance`` [m] and ``clearance/pair`` (K,), the same of
``own_clearance``. Processes read further series (`contribution`).
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from planner.catalogue.robots import RobotData
from planner.claims.claim import FeedWindow
from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray
from planner.geometry.units import DEG, MM
from planner.plans import Plan
from planner.problem import Problem, Settings
from planner.proof.verdict import Proof
from planner.report import markup
from planner.report.charts import Band, Level, Line, chart
from planner.report.contribution import EdgeSpeed, ProcessMotion, TimeChart, of_processes
from planner.report.markup import Figure


@dataclasses.dataclass(frozen=True)
class ArmMotion:
    """One arm over time (T,): serial joint angles, speeds, accelerations (T, 6); the margins [rad] (T,);
    ``singular`` (T,) [rad] off the nearest singular posture, where a proof says."""

    robot: RobotData
    time: FloatArray
    q: FloatArray
    speed: FloatArray
    acceleration: FloatArray | None
    singular: FloatArray | None = None

    @property
    def limit_margin(self) -> FloatArray:
        """Least distance (T,) [rad] to a joint limit."""
        return self.robot.limit_margin(self.q)

    @property
    def wrist_angle(self) -> FloatArray:
        """Angle (T,) [rad] of axis 5 from the posture where axes 4 and 6 are in line."""
        form = self.robot.form
        theta = form.signs[4] * self.q[:, 4] - form.offsets[4]
        return np.asarray(np.abs(np.arctan2(np.sin(theta), np.abs(np.cos(theta)))))


@dataclasses.dataclass(frozen=True)
class Clearance:
    """Least distance (T,) [m] of bodies that one clearance holds for, and between what."""

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
    """All that is drawn over time; ``source`` says where it comes from.

    ``work``: from when to when [s] the targets' segments run; at other times arms move alone, by their
    joints. Without any all of it is work. ``processes``: what the processes of a proven problem add.
    """

    arms: Mapping[str, ArmMotion]
    clearance: Clearance | None
    feed: Feed
    bands: tuple[Band, ...]
    source: str
    work: tuple[tuple[float, float], ...] = ()
    own_clearance: Clearance | None = None
    processes: tuple[ProcessMotion, ...] = ()

    def figure(self, title: str, lines: Sequence[Line], unit: str, note: str = "", **more: Any) -> Figure:
        """Lines over the time of the motion, with its segments; ``more`` as of `chart`."""
        body = chart(lines, x_label="s", y_label=unit, bands=self.bands, **more)
        return Figure(title, body, note)

    def wrist(self, arm: str) -> float:
        """Least wrist angle [rad] of an arm in the segments of the targets."""
        moved = self.arms[arm]
        inside = np.zeros(len(moved.time), dtype=bool)
        for start, end in self.work:
            inside |= (moved.time >= start) & (moved.time <= end)
        return float(np.min(moved.wrist_angle[inside if inside.any() else slice(None)]))


def motion_series(problem: Problem, plan: Plan, proof: Proof | None) -> Motion:
    """The motion of a plan, operations one after the other."""
    series: Mapping[str, Any] = proof.series if proof is not None else {}
    starts = operation_starts(plan)
    arms = _proven(problem, series)
    if arms:
        bands = _bands([Segment.read(str(v)) for v in series.get("label", ())], np.asarray(series["time"]))
        source = "replayed from the programs' text, from home to home"
        named = {segment.key for op in plan.operations for segment in op.targets.segment}
        work = tuple((band.start, band.end) for band in bands if band.name in named)
        near, own = (_clearance(series, name) for name in ("clearance", "own_clearance"))
        processes = tuple(one.motion(plan, series) for one in of_processes(problem))
        edges = edge_speeds(processes)
        feed = _proven_feed(plan, edges) if edges else _feed(plan, starts)
        return Motion(arms, near, feed, bands, source, work, own, processes)
    rows = [_bands(op.targets.segment, op.time + t) for op, t in zip(plan.operations, starts, strict=True)]
    bands = tuple(band for row in rows for band in row)
    shown = _planned(problem, plan, starts)
    return Motion(shown, None, _feed(plan, starts), bands, "the plan's targets")


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
        robot = arm.data
        more = (series.get(f"{name}/{arm.name}") for name in ("acceleration", "singular"))
        out[arm.name] = ArmMotion(robot, time, np.asarray(q), speed, *more)
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
        speed = np.concatenate([np.zeros((1, q.shape[1])), np.diff(q, axis=0) / step[:, None]])
        speed[np.concatenate([[True], np.diff(time) < 1e-6])] = 0.0
        out[arm.name] = ArmMotion(arm.data, time, q, speed, None)
    return out


def _clearance(series: Mapping[str, Any], name: str) -> Clearance | None:
    time, distance = series.get(f"{name}/time"), series.get(f"{name}/distance")
    if time is None or distance is None or not np.isfinite(distance).any():
        return None
    pair = series.get(f"{name}/pair", [""] * len(time))
    names = tuple(str(p).replace(" - ", " – ") for p in pair)
    return Clearance(np.asarray(time, dtype=np.float64), np.asarray(distance, dtype=np.float64), names)


def edge_speeds(processes: Sequence[ProcessMotion]) -> list[EdgeSpeed]:
    """Speeds of tools' edges that processes add, none where no edge enters the stock."""
    edges = [edge for process in processes for edge in process.speeds]
    return edges if any(np.isfinite(edge.speed).any() for edge in edges) else []


def _proven_feed(plan: Plan, edges: Sequence[EdgeSpeed]) -> Feed:
    """Speeds of the edges' fastest points inside the stock, with the windows that the claims state."""
    windows = {
        c.segment.key: c for op in plan.operations for c in op.targets.claims if isinstance(c, FeedWindow)
    }
    rows = []
    for edge in edges:
        lower = np.array([windows[v].lower if v in windows else np.nan for v in edge.label])
        upper = np.array([windows[v].upper if v in windows else np.nan for v in edge.label])
        rows.append(np.stack([edge.time, edge.speed, lower, upper]))
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


def feed(motion: Motion) -> Figure:
    """Speed of the fastest guarded point against the window that the process asks for [mm/s]."""
    f = motion.feed
    cut = np.isfinite(f.lower) & (f.lower > 0.0)
    lines = [
        Line("speed", f.time, f.speed / MM, 0),
        Line("highest allowed", f.time, np.where(np.isfinite(f.upper), f.upper / MM, np.nan), 1, True),
        Line("lowest allowed", f.time, np.where(cut, f.lower / MM, np.nan), 3, True),
    ]
    fastest = float(np.nanmax(f.speed, initial=1e-3)) / MM
    work = np.isfinite(f.speed) & cut
    top = min(1.1 * fastest, 2.2 * float(np.max(f.upper[work])) / MM) if work.any() else 1.1 * fastest
    top = max(top, 1.2 * float(np.max(f.upper[work])) / MM) if work.any() else top
    note = f"scaled to the work; moves outside it reach {markup.number(fastest, 3)} mm/s"
    note = note if fastest > top else "tinted strongest: work"
    return motion.figure("Speed of the fastest guarded point", lines, "mm/s", note, y_range=(0.0, top))


def clearance(data: Clearance, motion: Motion, settings: Settings) -> Figure:
    """Least distance over time [mm] with the asked one, and the pairs that come closest."""
    lines = [Line("arms, tools, block, obstacles", data.time, data.distance / MM, 2)]
    lines += [line for process in motion.processes for line in process.clearances]
    return _distances("Clearance to everything else", lines, settings.clearance, data, motion)


def own_clearance(data: Clearance, motion: Motion, settings: Settings) -> Figure:
    """Least distance of links and tool of one arm over time [mm], with the asked one."""
    lines = [Line("links and tool", data.time, data.distance / MM, 2)]
    return _distances("Clearance of each arm to itself", lines, settings.of_one_arm, data, motion)


def _distances(title: str, lines: Sequence[Line], wanted: float, data: Clearance, motion: Motion) -> Figure:
    """Distances over time [mm] with the ``wanted`` one [m]."""
    top = max([float(np.nanmax(line.y)) for line in lines if np.isfinite(line.y).any()] or [100.0])
    levels, y_range = [Level(wanted / MM, "asked for")], (0.0, min(top * 1.1, 150.0) + 1.0)
    return motion.figure(title, lines, "mm", least_words(data), levels=levels, y_range=y_range)


def least_words(data: Clearance) -> str:
    """The least distance, when it is, and between what."""
    worst = int(np.nanargmin(data.distance))
    at = f"{markup.fixed(data.distance[worst] / MM, 1)} mm at {markup.fixed(data.time[worst], 1)} s"
    return f"least: {at}" + (f", {data.pair[worst]}" if data.pair[worst] else "")


def drawn(charts: Sequence[TimeChart], motion: Motion) -> list[Figure]:
    """Charts that processes add, with the segments of the motion."""
    return [
        motion.figure(one.title, one.lines, one.unit, one.note, levels=one.levels, y_range=one.y_range)
        for one in charts
    ]


def closest_pairs(data: Clearance, count: int = 6) -> tuple[Figure, ...]:
    """For each pair that is the closest at some time: its least distance, when, and how often; nothing where
    no pairs are named."""
    rows: dict[str, tuple[float, float, int]] = {}
    for time, distance, pair in zip(data.time, data.distance, data.pair, strict=True):
        least, when, often = rows.get(pair, (np.inf, 0.0, 0))
        rows[pair] = (min(least, distance), time if distance < least else when, often + 1)
    total = max(len(data.time), 1)
    found = sorted(((v, k) for k, v in rows.items() if k), key=lambda item: item[0][0])[:count]
    cells = [
        (pair, markup.fixed(v[0] / MM, 1), markup.fixed(v[1], 1), f"{100 * v[2] / total:.0f} %")
        for v, pair in found
    ]
    if not cells:
        return ()
    shown = markup.table(("pair", "least [mm]", "at [s]", "closest for"), cells)
    return (Figure("Closest pairs", shown),)


def worst_by_rule(proof: Proof | None) -> dict[str, float]:
    """The worst figure of each rule of a proof that has one, by its code."""
    return {r.code: r.worst for r in (proof.rules if proof is not None else ()) if r.worst is not None}


def margins(motion: Motion, settings: Settings, proof: Proof | None) -> list[Figure]:
    """Distance to joint limits and to singular postures over time [deg]; without a proof, to that of the
    wrist. The least of each is the proof's own figure, as everywhere else."""
    proven = worst_by_rule(proof)
    arms = motion.arms.values()
    out = []
    for title, code, told, values, limit in (
        (
            "Distance to the nearest joint limit",
            "verify.joint_limits",
            "least",
            [arm.limit_margin for arm in arms],
            settings.joint_margin,
        ),
        (
            "Distance to the nearest singular posture",
            "verify.singularity",
            "least where tools move straight",
            [arm.singular for arm in arms],
            settings.singularity_margin,
        ),
    ):
        shown = [value for value in values if value is not None]
        least = proven.get(code, min((float(np.min(value)) for value in shown), default=0.0) / DEG)
        if len(shown) < len(values):
            title, told = "Axis 5 from wrist singularity", "least between targets"
            shown = [arm.wrist_angle for arm in arms]
            least = min((motion.wrist(name) for name in motion.arms), default=0.0) / DEG
        lines = [
            Line(name, arm.time, value / DEG, i)
            for i, ((name, arm), value) in enumerate(zip(motion.arms.items(), shown, strict=True))
        ]
        lowest = min((float(np.min(line.y)) for line in lines), default=0.0)
        highest = max([float(np.max(line.y)) for line in lines] or [1.0])
        y_range = (min(0.0, lowest), highest * 1.08)
        note = f"{told}: {markup.fixed(least, 1)}°" if np.isfinite(least) else ""
        levels = [Level(limit / DEG, "asked for")]
        out.append(motion.figure(title, lines, "deg", note, levels=levels, y_range=y_range))
    return out


def joints(name: str, arm: ArmMotion, motion: Motion) -> list[Figure]:
    """Small charts of an arm's joint angles with their limits [deg], one for each axis."""
    out = []
    for k in range(arm.robot.axes):
        lower, upper = arm.robot.lower[k] / DEG, arm.robot.upper[k] / DEG
        angle = arm.q[:, k] / DEG
        low, high = float(angle.min()), float(angle.max())
        air = max(0.15 * (high - low), 8.0)
        near = [Level(v, f"{v:.0f}°") for v in (lower, upper) if low - 40.0 < v < high + 40.0]
        shown = [level.value for level in near]
        y_range = min([low - air, *(v - 3 for v in shown)]), max([high + air, *(v + 3 for v in shown)])
        share = f"{low:.1f}° to {high:.1f}° of {lower:.0f}° to {upper:.0f}°".replace("-", "−")
        lines, size = [Line(f"axis {k + 1}", arm.time, angle, k)], (340.0, 150.0)
        title = f"{name}, axis {k + 1}"
        out.append(motion.figure(title, lines, "deg", share, levels=near, y_range=y_range, size=size))
    return out


def speeds(name: str, arm: ArmMotion, motion: Motion, settings: Settings) -> list[Figure]:
    """Joint speeds, and accelerations where known, as a share of their limits [%]."""
    out = []
    shares = [("speed", arm.speed, arm.robot.velocity, settings.speed_fraction)]
    if arm.acceleration is not None:
        most = settings.acceleration_fraction
        shares.append(("acceleration", np.asarray(arm.acceleration), arm.robot.acceleration, most))
    for what, value, limit, fraction in shares:
        share = 100.0 * np.abs(value) / limit
        most = float(np.nanmax(share))
        lines = [Line(f"axis {k + 1}", arm.time, share[:, k], k) for k in range(arm.robot.axes)]
        high = most * 1.15 + 1e-6 if most < 40.0 * fraction else max(most * 1.1, 108.0 * fraction)
        levels = [Level(100.0 * fraction, "allowed")]
        top = int(np.nanargmax(np.nanmax(share, axis=0)))
        allowed = f"{100 * fraction:.0f} % are allowed"
        note = f"highest: axis {top + 1}, {markup.fixed(most, 1)} % of its limit; {allowed}"
        title = f"{name}: joint {what}s"
        out.append(motion.figure(title, lines, "% of limit", note, levels=levels, y_range=(0.0, high)))
    return out
