"""Colours of the replay along the cut, from the proof: deviation, clearance and speed.

Values and words are those of the report: clearance and speed of `motion_charts`, deviations of the
simulated faces in the colours of their maps. Without a proof there are no colours.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np

from planner.claims.segments import WORKING_KINDS
from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.plans import Plan
from planner.problem import Problem
from planner.proof.verdict import CutFace, Proof
from planner.report import charts, markup, motion_charts
from planner.report.motion_charts import MotionSeries
from planner.report.plugin_contributions import face_words

KEY_COLOURS: Final = 33
"""Number of colours of a key, evenly spaced over its scale."""
MAX_FACE_POINTS: Final = 20_000
"""Maximum number of shown points of faces, evenly spaced and including the worst of each."""
_TOO_CLOSE_COLOUR: Final = np.array([0.85, 0.10, 0.45])
"""Colour where the clearance is below the required one."""
_NO_COLOUR: Final = np.array([0.6, 0.63, 0.66])
"""Colour where there is no value."""


@dataclasses.dataclass(frozen=True)
class ColourLayer:
    """One quantity along the cut, either as values over keyframes or as coloured points.

    Attributes:
        name: Name in the list of choices.
        title: Title of the key.
        unit: Unit of the values and of the scale.
        low: Lower end of the scale.
        high: Upper end of the scale.
        key: Colours (KEY_COLOURS, 3) in 0..1 from ``low`` to ``high``.
        limits: Values that are marked on the key, with their words.
        words: Statement of the report about the quantity.
        values: Values {arm: (T,)} over keyframes, under the empty name for all arms together. NaN where
            there is none.
        colours: Colours {arm: (T, 3)} in 0..1.
        points: Points (M, 3) [m] in the stock frame.
        point_colours: Colours of the points (M, 3) in 0..1.
        spacing: Approximate distance of the points [m].
    """

    name: str
    title: str
    unit: str
    low: float
    high: float
    key: FloatArray
    limits: tuple[tuple[float, str], ...]
    words: str
    values: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)
    colours: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)
    points: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((0, 3)))
    point_colours: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((0, 3)))
    spacing: float = 0.0


def colour_layers(
    problem: Problem, plan: Plan, proof: Proof | None, time: FloatArray
) -> tuple[ColourLayer, ...]:
    """Return the quantities that colour the cut, those of a proof that are known. Empty without a proof.

    Args:
        problem: Problem.
        plan: Plan.
        proof: Proof, or None.
        time: Times of the keyframes (T,) [s] on the clock of the programs.
    """
    if proof is None or not len(time):
        return ()
    motion = motion_charts.motion_series(problem, plan, proof)
    candidates = (
        _deviation(problem, proof.surfaces),
        _clearance(problem, motion, time),
        _speed(motion, proof, time),
    )
    return tuple(layer for layer in candidates if layer is not None)


def interval_extremes(at: FloatArray, value: FloatArray, time: FloatArray, use_min: bool) -> FloatArray:
    """Return the minimum or maximum of a curve in each interval between successive times, ends included.

    Args:
        at: Ascending abscissae of the curve (K,) [s].
        value: Values of the curve (K,), NaN in gaps.
        time: Ascending times (T,) [s].
        use_min: Return the minimum instead of the maximum.

    Returns:
        Extremes (T,) from the previous time to each time, the first one at its time only. NaN in intervals
        without a value.
    """
    is_finite = np.isfinite(value)
    out = np.full(len(time), np.nan)
    if not is_finite.any():
        return out
    ends = np.interp(time, at, value, left=np.nan, right=np.nan)
    extreme = np.fmin if use_min else np.fmax
    first = np.searchsorted(at, np.concatenate([time[:1], time[:-1]]), side="left")
    last = np.searchsorted(at, time, side="right")
    previous_ends = np.concatenate([ends[:1], ends[:-1]])
    for k, (a, b) in enumerate(zip(first, last, strict=True)):
        inside = extreme.reduce(value[a:b]) if b > a else np.nan
        out[k] = extreme(extreme(previous_ends[k], ends[k]), inside)
    return out


def _clearance(problem: Problem, motion: MotionSeries, time: FloatArray) -> ColourLayer | None:
    """Return the minimum distance of bodies that must not touch, or None if the proof has none."""
    data = motion.clearance
    if data is None:
        return None
    required = problem.settings.clearance / MM
    high = max(4.0 * required, 40.0)
    values = interval_extremes(data.time, data.distance / MM, time, use_min=True)

    def colours(value: FloatArray) -> FloatArray:
        return np.where(
            (value < required - 1e-6)[..., None],
            _TOO_CLOSE_COLOUR,
            charts.sequential(np.clip(value / high, 0, 1)),
        )

    title = "clearance of arms, tools, block, obstacles"
    scale = _ColourScale("mm", 0.0, high, colours, ((required, "required"),))
    return _layer("clearance", title, scale, motion_charts.minimum_text(data), {"": values})


def _speed(motion: MotionSeries, proof: Proof, time: FloatArray) -> ColourLayer | None:
    """Return the colour layer with the speed of the tool for the 3D replay, or None if it is unknown.

    It is the speed of the edges of linear cutters inside the stock, with its limits. Other processes have no
    such edges, and the layer shows the speed of each TCP instead. ``time`` [s] are the times of the replay.
    """
    series = proof.series
    feed, edges = motion.feed, motion_charts.edge_speeds(motion.processes)
    if edges:
        is_finite = np.isfinite(feed.speed)
        curves = [(edge.time, edge.speed) for edge in edges]
        curves.sort(key=lambda curve: float(curve[0][0]) if len(curve[0]) else 0.0)
        values = {"": interval_extremes(*_concatenated(curves), time, use_min=False)}
        has_window = is_finite & np.isfinite(feed.lower) & (feed.lower > 0.0)
        limits = (
            [
                (float(np.min(feed.lower[has_window])) / MM, "minimum"),
                (float(np.max(feed.upper[has_window])) / MM, "maximum"),
            ]
            if has_window.any()
            else []
        )
        speeds = feed.speed[has_window if has_window.any() else is_finite] / MM
        title = edges[0].title
    else:
        names = [name for name in series if name.startswith("tcp_speed/")]
        if not names:
            return None
        at = np.asarray(series["time"], dtype=np.float64)
        values = {
            name.partition("/")[2]: interval_extremes(at, np.asarray(series[name]) / MM, time, use_min=False)
            for name in names
        }
        limits = []
        bands = [band for band in motion.bands if band.kind in WORKING_KINDS]
        within = [(at >= band.start) & (at <= band.end) for band in bands] or [np.ones(len(at), dtype=bool)]
        is_working = np.logical_or.reduce(within)
        speeds = np.concatenate([np.asarray(series[name])[is_working] / MM for name in names])
        title = "speed of the tool tip"
    if not len(speeds) or not np.isfinite(speeds).any():
        return None
    high = 1.1 * max([float(np.nanmax(speeds)), *(value for value, _ in limits if np.isfinite(value))])
    min_text, max_text = (markup.number(float(extreme(speeds)), 3) for extreme in (np.nanmin, np.nanmax))
    words = f"from {min_text} to {max_text} mm/s during work"

    def colours(value: FloatArray) -> FloatArray:
        return charts.sequential(np.clip(value / max(high, 1e-9), 0.0, 1.0))

    kept = tuple((value, word) for value, word in limits if np.isfinite(value))
    return _layer("speed", title, _ColourScale("mm/s", 0.0, high, colours, kept), words, values)


def _concatenated(curves: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    """Join curves [s, m/s] to one [s, mm/s], with a NaN before and after each against interpolation."""
    gap = np.array([np.nan])
    at = [np.concatenate([time[:1] - 1e-6, time, time[-1:] + 1e-6]) for time, _ in curves if len(time)]
    value = [np.concatenate([gap, speed / MM, gap]) for time, speed in curves if len(time)]
    return np.concatenate(at), np.concatenate(value)


@dataclasses.dataclass(frozen=True)
class _ColourScale:
    """Scale of a layer: how values become colours.

    Attributes:
        unit: Unit of the values.
        low: Lower end of the scale.
        high: Upper end of the scale.
        colours: Colours (..., 3) in 0..1 of values (...,).
        limits: Marks on the key with their words.
    """

    unit: str
    low: float
    high: float
    colours: Callable[[FloatArray], FloatArray]
    limits: tuple[tuple[float, str], ...]


def _layer(
    name: str, title: str, scale: _ColourScale, words: str, values: Mapping[str, FloatArray]
) -> ColourLayer:
    """Return a layer with one colour for each value, `_NO_COLOUR` where the value is NaN."""
    key = scale.colours(np.linspace(scale.low, scale.high, KEY_COLOURS))
    colours = {
        arm: np.where(
            np.isnan(arm_values)[:, None],
            _NO_COLOUR,
            scale.colours(np.where(np.isnan(arm_values), scale.low, arm_values)),
        )
        for arm, arm_values in values.items()
    }
    return ColourLayer(
        name, title, scale.unit, scale.low, scale.high, key, scale.limits, words, values, colours
    )


def _deviation(problem: Problem, faces: Sequence[CutFace]) -> ColourLayer | None:
    """Return the colour layer with the deviations of the simulated faces, or None without faces.

    It consists of coloured points. At most about ``MAX_FACE_POINTS`` are drawn, and the worst point of each
    face is always one of them.
    """
    faces = [face for face in faces if len(face.points)]
    if not faces:
        return None
    span = max(charts.colour_span(face.deviation, face.tolerance) for face in faces)
    fraction = min(1.0, MAX_FACE_POINTS / sum(len(face.points) for face in faces))
    points, colours = [], []
    for face in faces:
        kept = np.unique(
            np.linspace(0, len(face.points) - 1, max(1, int(fraction * len(face.points)))).astype(int)
        )
        if np.isfinite(face.deviation).any():
            kept = np.union1d(kept, [int(np.nanargmax(np.abs(face.deviation)))])
        deviation = face.deviation[kept]
        points.append(face.points[kept])
        face_colours = charts.diverging(np.nan_to_num(deviation), span)
        colours.append(np.where(np.isfinite(deviation)[:, None], face_colours, charts.MISSED_COLOUR))
    area = np.concatenate([face.area for face in faces])
    spacing = float(np.sqrt(np.mean(area) / fraction)) if len(area) else 0.0
    uniform_tolerances = [face.tolerance for face in faces if not len(face.allowed)]
    limit = min(uniform_tolerances, default=np.inf) / MM  # a tolerance that varies over the face gets no mark
    high = span / MM
    key = charts.diverging(np.linspace(-high, high, KEY_COLOURS), high)
    marks = tuple((sign * limit, "allowed") for sign in (-1.0, 1.0) if limit <= high)
    worst_face = max(faces, key=lambda face: face.largest)
    words = (
        f"largest: {worst_face.largest / MM:.3f} mm, {worst_face.title}; root mean square there "
        f"{worst_face.rms / MM:.3f} mm, allowed "
        f"{markup.allowed_deviation(worst_face.allowed, worst_face.tolerance)} mm"
    ) + (f"; {len(faces)} faces" if len(faces) > 1 else "")
    colour_meanings = [
        (terms.negative, terms.positive, terms.missing)
        for terms in (face_words(problem, face) for face in faces)
    ]
    blue, red, missed = (" or ".join(dict.fromkeys(terms)) for terms in zip(*colour_meanings, strict=True))
    title = f"deviation from the nominal part: blue {blue}, red {red}, violet {missed}"
    return ColourLayer(
        "deviation",
        title,
        "mm",
        -high,
        high,
        key,
        marks,
        words,
        points=np.concatenate(points),
        point_colours=np.concatenate(colours),
        spacing=spacing,
    )
