"""Charts of a motion on one clock: feed, clearances, margins, joint angles and speeds, and limits.

They are drawn from the replay of the proof or, without one, from the plan. Optional keys of
``Proof.series``:

- ``time`` (T,) [s] of the samples, and ``label`` (T,): the segment of each sample,
- for each arm ``joints/<arm>``, ``speed/<arm>``, ``acceleration/<arm>`` (T, 6) [rad, rad/s, rad/s^2], and
  ``singular/<arm>``,
- ``clearance/time``, ``clearance/distance`` [m] and ``clearance/pair`` (K,), and the same keys of
  ``own_clearance``.

Processes read further series (`plugin_contributions`).
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
from planner.report.charts import ChartAxes, ChartBand, ChartLine, LimitLine, chart
from planner.report.markup import FigureBlock
from planner.report.plugin_contributions import EdgeSpeed, ProcessMotion, TimeChart, process_reports


@dataclasses.dataclass(frozen=True)
class ArmMotion:
    """Motion of one arm.

    Attributes:
        robot: Robot.
        time: Time (T,) [s].
        q: Serial joint angles (T, 6) [rad].
        speed: Joint speeds (T, 6) [rad/s].
        acceleration: Joint accelerations (T, 6) [rad/s^2], or None.
        singular: Distance from the nearest singular posture (T,) [rad], if the proof has it.
    """

    robot: RobotData
    time: FloatArray
    q: FloatArray
    speed: FloatArray
    acceleration: FloatArray | None
    singular: FloatArray | None = None

    @property
    def limit_margin(self) -> FloatArray:
        """Minimum distance (T,) [rad] from a joint limit."""
        return self.robot.limit_margin(self.q)

    @property
    def wrist_angle(self) -> FloatArray:
        """Angle (T,) [rad] in 0..pi/2 of axis 5 from the posture in which axes 4 and 6 are collinear."""
        form = self.robot.form
        theta = form.signs[4] * self.q[:, 4] - form.offsets[4]
        return np.asarray(np.abs(np.arctan2(np.sin(theta), np.abs(np.cos(theta)))))


@dataclasses.dataclass(frozen=True)
class ClearanceSeries:
    """Minimum distance (T,) [m] between bodies that one clearance applies to, and the closest pairs."""

    time: FloatArray
    distance: FloatArray
    pair: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class FeedSeries:
    """Speed (N,) [m/s] on the path to each target with its window, at ``time`` (N,) [s]."""

    time: FloatArray
    speed: FloatArray
    lower: FloatArray
    upper: FloatArray


@dataclasses.dataclass(frozen=True)
class MotionSeries:
    """Everything that is drawn over time.

    Attributes:
        arms: Motion by arm.
        clearance: Clearance between arms, tools, block and obstacles.
        feed: Feed.
        bands: Intervals of the segments.
        source: Source of the data, as text.
        work: Intervals [s] of the targets' segments. At other times arms move alone, by joint motion.
            Empty: everything.
        own_clearance: Clearance of each arm to itself.
        processes: Contributions of the processes of a proven problem.
    """

    arms: Mapping[str, ArmMotion]
    clearance: ClearanceSeries | None
    feed: FeedSeries
    bands: tuple[ChartBand, ...]
    source: str
    work: tuple[tuple[float, float], ...] = ()
    own_clearance: ClearanceSeries | None = None
    processes: tuple[ProcessMotion, ...] = ()

    def figure(
        self,
        title: str,
        lines: Sequence[ChartLine],
        unit: str,
        note: str = "",
        *,
        y_range: tuple[float, float] | None = None,
        **more: Any,
    ) -> FigureBlock:
        """Draw lines over the time of the motion, with its segments.

        Args:
            title: Title.
            lines: Curves.
            unit: Unit of the curves.
            note: Note.
            y_range: Range of the y axis, or None to fit the data.
            more: Further arguments of `chart`.
        """
        body = chart(lines, ChartAxes("s", unit, y_range), bands=self.bands, **more)
        return FigureBlock(title, body, note)

    def min_wrist_angle(self, arm: str) -> float:
        """Return the minimum wrist angle [rad] of an arm in the intervals of :attr:`work`."""
        moved = self.arms[arm]
        inside = np.zeros(len(moved.time), dtype=bool)
        for start, end in self.work:
            inside |= (moved.time >= start) & (moved.time <= end)
        return float(np.min(moved.wrist_angle[inside if inside.any() else slice(None)]))


def motion_series(problem: Problem, plan: Plan, proof: Proof | None) -> MotionSeries:
    """Return the motion that the charts of the report show, with its operations in sequence.

    It is the replay of the proof, from home to home. Without it, it is the motion of the plan, which is known
    only at its targets.

    Args:
        problem: Problem.
        plan: Plan.
        proof: Proof, or None.
    """
    series: Mapping[str, Any] = proof.series if proof is not None else {}
    starts = operation_starts(plan)
    arms = _proven_arms(problem, series)
    if arms:
        bands = _segment_bands(
            [Segment.read(str(v)) for v in series.get("label", ())], np.asarray(series["time"])
        )
        source = "replayed from the programs' text, from home to home"
        target_segments = {segment.key for op in plan.operations for segment in op.targets.segment}
        work = tuple((band.start, band.end) for band in bands if band.name in target_segments)
        clearance_data, own_clearance_data = (
            _clearance(series, name) for name in ("clearance", "own_clearance")
        )
        processes = tuple(process.motion(plan, series) for process in process_reports(problem))
        edges = edge_speeds(processes)
        feed = _proven_feed(plan, edges) if edges else _feed(plan, starts)
        return MotionSeries(arms, clearance_data, feed, bands, source, work, own_clearance_data, processes)
    bands_by_operation = [
        _segment_bands(op.targets.segment, op.time + t) for op, t in zip(plan.operations, starts, strict=True)
    ]
    bands = tuple(band for operation_bands in bands_by_operation for band in operation_bands)
    arms = _planned_arms(problem, plan, starts)
    return MotionSeries(
        arms, clearance=None, feed=_feed(plan, starts), bands=bands, source="the plan's targets"
    )


def operation_starts(plan: Plan) -> list[float]:
    """Return the time [s] at which the clock of each operation starts if they run in sequence."""
    lengths = [float(op.time[-1]) if len(op.time) else 0.0 for op in plan.operations]
    return [float(sum(lengths[:i])) for i in range(len(lengths))]


def _proven_arms(problem: Problem, series: Mapping[str, Any]) -> dict[str, ArmMotion]:
    """Return the motion of each arm whose joint angles are in the ``series`` of the proof.

    If the series has no speeds of an arm, they are the derivatives of its joint angles.
    """
    out = {}
    for arm in problem.cell.arms:
        q = series.get(f"joints/{arm.name}")
        if q is None or len(q) < 2:
            continue
        time = np.asarray(series["time"], dtype=np.float64)
        replayed_speed = series.get(f"speed/{arm.name}")
        speed = np.gradient(q, time, axis=0) if replayed_speed is None else np.asarray(replayed_speed)
        robot = arm.data
        optional_series = (series.get(f"{name}/{arm.name}") for name in ("acceleration", "singular"))
        out[arm.name] = ArmMotion(robot, time, np.asarray(q), speed, *optional_series)
    return out


def _planned_arms(problem: Problem, plan: Plan, starts: list[float]) -> dict[str, ArmMotion]:
    """Return the motion of each arm from its targets. A speed is the mean one on the path to the target."""
    out = {}
    for arm in problem.cell.arms:
        own_operations = [(op, t) for op, t in zip(plan.operations, starts, strict=True) if arm.name in op.q]
        if not own_operations or sum(len(op.time) for op, _ in own_operations) < 2:
            continue
        time = np.concatenate([op.time + t for op, t in own_operations])
        q = np.concatenate([op.q[arm.name] for op, _ in own_operations])
        step = np.maximum(np.diff(time), 1e-9)
        speed = np.concatenate([np.zeros((1, q.shape[1])), np.diff(q, axis=0) / step[:, None]])
        speed[np.concatenate([[True], np.diff(time) < 1e-6])] = 0.0
        out[arm.name] = ArmMotion(arm.data, time, q, speed, acceleration=None)
    return out


def _clearance(series: Mapping[str, Any], name: str) -> ClearanceSeries | None:
    """Return the series ``<name>/time``, ``/distance`` and ``/pair``, or None without a finite distance."""
    time, distance = series.get(f"{name}/time"), series.get(f"{name}/distance")
    if time is None or distance is None or not np.isfinite(distance).any():
        return None
    pair = series.get(f"{name}/pair", [""] * len(time))
    names = tuple(str(p).replace(" - ", " – ") for p in pair)
    return ClearanceSeries(np.asarray(time, dtype=np.float64), np.asarray(distance, dtype=np.float64), names)


def edge_speeds(processes: Sequence[ProcessMotion]) -> list[EdgeSpeed]:
    """Return the speeds of tool edges that processes add. Empty if no edge enters the stock."""
    edges = [edge for process in processes for edge in process.speeds]
    return edges if any(np.isfinite(edge.speed).any() for edge in edges) else []


def _proven_feed(plan: Plan, edges: Sequence[EdgeSpeed]) -> FeedSeries:
    """Return the speeds of the edges inside the stock, with the windows that the plan claims for segments."""
    windows = {
        claim.segment.key: claim
        for op in plan.operations
        for claim in op.targets.claims
        if isinstance(claim, FeedWindow)
    }
    series_by_edge = []
    for edge in edges:
        lower = np.array([windows[key].lower if key in windows else np.nan for key in edge.label])
        upper = np.array([windows[key].upper if key in windows else np.nan for key in edge.label])
        series_by_edge.append(np.stack([edge.time, edge.speed, lower, upper]))
    return FeedSeries(*np.concatenate(series_by_edge, axis=1))


def _feed(plan: Plan, starts: list[float]) -> FeedSeries:
    """Return the mean speed on the path to each target of the plan, NaN where the tool does not move."""
    series_by_operation = []
    for op, start in zip(plan.operations, starts, strict=True):
        step = np.diff(op.time, prepend=op.time[:1])
        moved = (step > 1e-9) & (op.targets.travel > 1e-9)
        speed = np.where(moved, op.targets.travel / np.maximum(step, 1e-9), np.nan)
        series_by_operation.append(np.stack([op.time + start, speed, op.targets.feed_min, op.targets.feed]))
    series = np.concatenate(series_by_operation, axis=1) if series_by_operation else np.zeros((4, 0))
    return FeedSeries(*series)


def _segment_bands(segments: Sequence[Segment], time: FloatArray) -> tuple[ChartBand, ...]:
    """Return an interval for each run of instants (T,) [s] with the same segment.

    A segment belongs to the path to its instant, so that a run starts at the instant before it.
    """
    count = min(len(segments), len(time))
    run_starts = [i for i in range(1, count) if i == 1 or segments[i] != segments[i - 1]]
    return tuple(
        ChartBand(float(time[a - 1]), float(time[b - 1]), str(segments[a]), segments[a].kind)
        for a, b in itertools.pairwise([*run_starts, count])
    )


def feed_figure(motion: MotionSeries) -> FigureBlock:
    """Draw the speed of the fastest point that the feed limits guard [mm/s], with these limits.

    A minimum is drawn only where it is above 0. The vertical scale fits the work, so faster moves outside the
    work may exceed the chart.
    """
    f = motion.feed
    guarded = np.isfinite(f.lower) & (f.lower > 0.0)
    lines = [  # the limits are dashed
        ChartLine("speed", f.time, f.speed / MM, 0),
        ChartLine("maximum allowed", f.time, np.where(np.isfinite(f.upper), f.upper / MM, np.nan), 1, True),
        ChartLine("minimum allowed", f.time, np.where(guarded, f.lower / MM, np.nan), 3, True),
    ]
    fastest = float(np.nanmax(f.speed, initial=1e-3)) / MM
    working = np.isfinite(f.speed) & guarded
    top = min(1.1 * fastest, 2.2 * float(np.max(f.upper[working])) / MM) if working.any() else 1.1 * fastest
    top = max(top, 1.2 * float(np.max(f.upper[working])) / MM) if working.any() else top
    note = f"scaled to the work; other moves reach {markup.number(fastest, 3)} mm/s"
    note = note if fastest > top else "strongest tint: work"
    return motion.figure("Speed of the fastest guarded point", lines, "mm/s", note, y_range=(0.0, top))


def clearance_figure(data: ClearanceSeries, motion: MotionSeries, settings: Settings) -> FigureBlock:
    """Draw the minimum distance over time [mm], with those that processes add and the required one."""
    lines = [ChartLine("arms, tools, block, obstacles", data.time, data.distance / MM, 2)]
    lines += [line for process in motion.processes for line in process.clearances]
    return _distance_figure("Clearance to everything else", lines, settings.clearance, data, motion)


def own_clearance_figure(data: ClearanceSeries, motion: MotionSeries, settings: Settings) -> FigureBlock:
    """Draw the minimum distance between links and tool of one arm over time [mm]."""
    lines = [ChartLine("links and tool", data.time, data.distance / MM, 2)]
    return _distance_figure("Clearance of each arm to itself", lines, settings.self_clearance, data, motion)


def _distance_figure(
    title: str, lines: Sequence[ChartLine], required: float, data: ClearanceSeries, motion: MotionSeries
) -> FigureBlock:
    """Draw distances over time [mm] with the required one [m]. The scale ends at 151 mm or earlier."""
    top = max([float(np.nanmax(line.y)) for line in lines if np.isfinite(line.y).any()] or [100.0])
    levels, y_range = [LimitLine(required / MM, "required")], (0.0, min(top * 1.1, 150.0) + 1.0)
    return motion.figure(title, lines, "mm", minimum_text(data), levels=levels, y_range=y_range)


def minimum_text(data: ClearanceSeries) -> str:
    """Return the minimum distance, its time, and the pair, as text."""
    worst_index = int(np.nanargmin(data.distance))
    minimum = (
        f"{markup.fixed_decimals(data.distance[worst_index] / MM, 1)} mm at "
        f"{markup.fixed_decimals(data.time[worst_index], 1)} s"
    )
    return f"minimum: {minimum}" + (f", {data.pair[worst_index]}" if data.pair[worst_index] else "")


def process_figures(charts: Sequence[TimeChart], motion: MotionSeries) -> list[FigureBlock]:
    """Draw the charts that processes add, with the segments of the motion."""
    return [
        motion.figure(
            process_chart.title,
            process_chart.lines,
            process_chart.unit,
            process_chart.note,
            levels=process_chart.levels,
            y_range=process_chart.y_range,
        )
        for process_chart in charts
    ]


def closest_pairs(data: ClearanceSeries, count: int = 6) -> tuple[FigureBlock, ...]:
    """Tabulate pairs that are the closest at some time: minimum distance, its time, and how often.

    Args:
        data: Clearance.
        count: Maximum number of pairs.

    Returns:
        A figure, or nothing if no pairs are named.
    """
    by_pair: dict[str, tuple[float, float, int]] = {}
    for time, distance, pair in zip(data.time, data.distance, data.pair, strict=True):
        minimum, when, count_closest = by_pair.get(pair, (np.inf, 0.0, 0))
        by_pair[pair] = (min(minimum, distance), time if distance < minimum else when, count_closest + 1)
    total = max(len(data.time), 1)
    closest = sorted(((v, pair) for pair, v in by_pair.items() if pair), key=lambda item: item[0][0])[:count]
    cells = [
        (
            pair,
            markup.fixed_decimals(minimum / MM, 1),
            markup.fixed_decimals(when, 1),
            f"{100 * count_closest / total:.0f} %",
        )
        for (minimum, when, count_closest), pair in closest
    ]
    if not cells:
        return ()
    shown = markup.make_table(("pair", "minimum [mm]", "at [s]", "closest for"), cells)
    return (FigureBlock("Closest pairs", shown),)


def worst_by_rule(proof: Proof | None) -> dict[str, float]:
    """Return the worst value of each rule of a proof that has one, in the rule's unit, by the rule's code."""
    return {r.code: r.worst for r in (proof.rules if proof is not None else ()) if r.worst is not None}


def margin_figures(motion: MotionSeries, settings: Settings, proof: Proof | None) -> list[FigureBlock]:
    """Draw the distances from joint limits and from singular postures over time [deg], one chart each.

    If the distance from singular postures is not known for all arms, because there is no proof, the distance
    of axis 5 from the wrist singularity is drawn instead. The note states the minimum that the proof found if
    there is one, so that all parts of the report agree.

    Args:
        motion: Motion.
        settings: Settings of the problem.
        proof: Proof, or None.
    """
    proven = worst_by_rule(proof)
    arms = motion.arms.values()
    out = []
    for title, code, statement, values, limit in (
        (
            "Distance to the nearest joint limit",
            "verify.joint_limits",
            "minimum",
            [arm.limit_margin for arm in arms],
            settings.joint_margin,
        ),
        (
            "Distance to the nearest singular posture",
            "verify.singularity",
            "minimum during linear moves",
            [arm.singular for arm in arms],
            settings.singularity_margin,
        ),
    ):
        shown = [value for value in values if value is not None]
        minimum = proven.get(code, min((float(np.min(value)) for value in shown), default=0.0) / DEG)
        if len(shown) < len(values):  # the proof has no distance from singular postures
            title, statement = "Axis 5 from wrist singularity", "minimum between targets"
            shown = [arm.wrist_angle for arm in arms]
            minimum = min((motion.min_wrist_angle(name) for name in motion.arms), default=0.0) / DEG
        lines = [
            ChartLine(name, arm.time, value / DEG, i)
            for i, ((name, arm), value) in enumerate(zip(motion.arms.items(), shown, strict=True))
        ]
        lowest = min((float(np.min(line.y)) for line in lines), default=0.0)
        highest = max([float(np.max(line.y)) for line in lines] or [1.0])
        y_range = (min(0.0, lowest), highest * 1.08)
        note = f"{statement}: {markup.fixed_decimals(minimum, 1)}°" if np.isfinite(minimum) else ""
        levels = [LimitLine(limit / DEG, "required")]
        out.append(motion.figure(title, lines, "deg", note, levels=levels, y_range=y_range))
    return out


def joint_figures(name: str, arm: ArmMotion, motion: MotionSeries) -> list[FigureBlock]:
    """Draw small charts of the joint angles of an arm with their limits [deg], one for each axis."""
    out = []
    for k in range(arm.robot.axes):
        lower, upper = arm.robot.lower[k] / DEG, arm.robot.upper[k] / DEG
        angle = arm.q[:, k] / DEG
        low, high = float(angle.min()), float(angle.max())
        padding = max(0.15 * (high - low), 8.0)
        nearby_limits = [LimitLine(v, f"{v:.0f}°") for v in (lower, upper) if low - 40.0 < v < high + 40.0]
        shown_limits = [level.value for level in nearby_limits]
        y_range = (
            min([low - padding, *(v - 3 for v in shown_limits)]),
            max([high + padding, *(v + 3 for v in shown_limits)]),
        )
        range_text = f"{low:.1f}° to {high:.1f}° of {lower:.0f}° to {upper:.0f}°".replace("-", "−")
        lines = [ChartLine(f"axis {k + 1}", arm.time, angle, k)]
        size = (340.0, 150.0)
        title = f"{name}, axis {k + 1}"
        out.append(
            motion.figure(title, lines, "deg", range_text, levels=nearby_limits, y_range=y_range, size=size)
        )
    return out


def speed_figures(name: str, arm: ArmMotion, motion: MotionSeries, settings: Settings) -> list[FigureBlock]:
    """Draw joint speeds, and accelerations if known, relative to their limits [%]."""
    out = []
    quantities = [("speed", arm.speed, arm.robot.velocity, settings.speed_fraction)]
    if arm.acceleration is not None:
        allowed_fraction = settings.acceleration_fraction
        acceleration = np.asarray(arm.acceleration)
        quantities.append(("acceleration", acceleration, arm.robot.acceleration, allowed_fraction))
    for quantity, value, limit, fraction in quantities:
        percent = 100.0 * np.abs(value) / limit
        maximum = float(np.nanmax(percent))
        lines = [ChartLine(f"axis {k + 1}", arm.time, percent[:, k], k) for k in range(arm.robot.axes)]
        # the limit is outside the chart if the values are far below it
        top = maximum * 1.15 + 1e-6 if maximum < 40.0 * fraction else max(maximum * 1.1, 108.0 * fraction)
        levels = [LimitLine(100.0 * fraction, "allowed")]
        axis = int(np.nanargmax(np.nanmax(percent, axis=0)))
        allowed = f"allowed {100 * fraction:.0f} %"
        note = f"maximum: axis {axis + 1}, {markup.fixed_decimals(maximum, 1)} % of its limit; {allowed}"
        title = f"{name}: joint {quantity}s"
        out.append(motion.figure(title, lines, "% of limit", note, levels=levels, y_range=(0.0, top)))
    return out
