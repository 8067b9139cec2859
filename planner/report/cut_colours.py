"""What a proof found along the cut, as colours of the replay: deviation, clearance, speed.

Figures and words are those of the report: clearance and speed of `motion_charts`, deviation of the simulated
faces in the colours of their maps. Without a proof there are none.
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
from planner.report.contribution import face_words
from planner.report.motion_charts import Motion

SHADES: Final = 33
"""Colours of a key, evenly from one end of its scale to the other."""
FACE_POINTS: Final = 20_000
"""Points of simulated faces that are shown at most, spread evenly, the worst of each face among them."""
_NEAR_COLOUR: Final = np.array([0.85, 0.10, 0.45])
"""Where less than what is asked for is kept."""
_NO_COLOUR: Final = np.array([0.6, 0.63, 0.66])
"""Where there is no figure."""


@dataclasses.dataclass(frozen=True)
class Layer:
    """One figure along the cut. ``values`` {arm: (T,)} in ``unit`` over keyframes, of all arms together under
    the empty name, NaN where there is none; ``colours`` {arm: (T, 3)} in 0..1; ``key`` (SHADES, 3) from
    ``low`` to ``high``; ``limits``: marks on the key with their words; ``words``: what the report says of it.
    ``points`` (M, 3) [m] in the stock frame with colours of their own, about ``spacing`` [m] apart."""

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


def layers(problem: Problem, plan: Plan, proof: Proof | None, time: FloatArray) -> tuple[Layer, ...]:
    """The figures that a proof has over keyframes at ``time`` (T,) [s] on the programs' clock."""
    if proof is None or not len(time):
        return ()
    motion = motion_charts.motion_series(problem, plan, proof)
    found = (
        _deviation(problem, proof.surfaces),
        _clearance(problem, motion, time),
        _speed(motion, proof, time),
    )
    return tuple(layer for layer in found if layer is not None)


def worst(at: FloatArray, value: FloatArray, time: FloatArray, least: bool) -> FloatArray:
    """The least or the greatest of a curve ``value`` at ``at`` (K,) ascending [s] on the way to each of
    ``time`` (T,), both ends included; NaN where the curve has a gap, and outside it."""
    known = np.isfinite(value)
    out = np.full(len(time), np.nan)
    if not known.any():
        return out
    ends = np.interp(time, at, value, left=np.nan, right=np.nan)
    pick = np.fmin if least else np.fmax
    first = np.searchsorted(at, np.concatenate([time[:1], time[:-1]]), side="left")
    last = np.searchsorted(at, time, side="right")
    before = np.concatenate([ends[:1], ends[:-1]])
    for k, (a, b) in enumerate(zip(first, last, strict=True)):
        inside = pick.reduce(value[a:b]) if b > a else np.nan
        out[k] = pick(pick(before[k], ends[k]), inside)
    return out


def _clearance(problem: Problem, motion: Motion, time: FloatArray) -> Layer | None:
    data = motion.clearance
    if data is None:
        return None
    asked = problem.settings.clearance / MM
    high = max(4.0 * asked, 40.0)
    values = worst(data.time, data.distance / MM, time, least=True)

    def colours(value: FloatArray) -> FloatArray:
        return np.where(
            (value < asked - 1e-6)[..., None], _NEAR_COLOUR, charts.sequential(np.clip(value / high, 0, 1))
        )

    title = "clearance of arms, tools, block, obstacles"
    return _layer(
        "clearance",
        title,
        "mm",
        (0.0, high),
        colours,
        ((asked, "asked for"),),
        motion_charts.least_words(data),
        {"": values},
    )


def _speed(motion: Motion, proof: Proof, time: FloatArray) -> Layer | None:
    series = proof.series
    feed, edges = motion.feed, motion_charts.edge_speeds(motion.processes)
    if edges:
        known = np.isfinite(feed.speed)
        stretches = [(edge.time, edge.speed) for edge in edges]
        stretches.sort(key=lambda one: float(one[0][0]) if len(one[0]) else 0.0)
        values = {"": worst(*_apart(stretches), time, least=False)}
        work = known & np.isfinite(feed.lower) & (feed.lower > 0.0)
        limits = (
            [
                (float(np.min(feed.lower[work])) / MM, "lowest"),
                (float(np.max(feed.upper[work])) / MM, "highest"),
            ]
            if work.any()
            else []
        )
        inside = feed.speed[work if work.any() else known] / MM
        title = edges[0].title
    else:
        names = [name for name in series if name.startswith("tcp_speed/")]
        if not names:
            return None
        at = np.asarray(series["time"], dtype=np.float64)
        values = {
            name.partition("/")[2]: worst(at, np.asarray(series[name]) / MM, time, least=False)
            for name in names
        }
        limits = []
        bands = [band for band in motion.bands if band.kind in WORKING_KINDS]
        within = [(at >= band.start) & (at <= band.end) for band in bands] or [np.ones(len(at), dtype=bool)]
        works = np.logical_or.reduce(within)
        inside = np.concatenate([np.asarray(series[name])[works] / MM for name in names])
        title = "speed of the tool's tip"
    if not len(inside) or not np.isfinite(inside).any():
        return None
    high = 1.1 * max([float(np.nanmax(inside)), *(value for value, _ in limits if np.isfinite(value))])
    least, most = (markup.number(float(pick(inside)), 3) for pick in (np.nanmin, np.nanmax))
    words = f"from {least} to {most} mm/s in the work"

    def colours(value: FloatArray) -> FloatArray:
        return charts.sequential(np.clip(value / max(high, 1e-9), 0.0, 1.0))

    kept = tuple((value, word) for value, word in limits if np.isfinite(value))
    return _layer("speed", title, "mm/s", (0.0, high), colours, kept, words, values)


def _apart(curves: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    """Curves [s, m/s] one after the other as one [s, mm/s], with nothing known between two of them."""
    none = np.array([np.nan])
    at = [np.concatenate([time[:1] - 1e-6, time, time[-1:] + 1e-6]) for time, _ in curves if len(time)]
    value = [np.concatenate([none, speed / MM, none]) for time, speed in curves if len(time)]
    return np.concatenate(at), np.concatenate(value)


def _layer(
    name: str,
    title: str,
    unit: str,
    ends: tuple[float, float],
    colours: Callable[[FloatArray], FloatArray],
    limits: tuple[tuple[float, str], ...],
    words: str,
    values: Mapping[str, FloatArray],
) -> Layer:
    low, high = ends
    key = colours(np.linspace(low, high, SHADES))
    shown = {
        arm: np.where(np.isnan(own)[:, None], _NO_COLOUR, colours(np.where(np.isnan(own), low, own)))
        for arm, own in values.items()
    }
    return Layer(name, title, unit, low, high, key, limits, words, values, shown)


def _deviation(problem: Problem, faces: Sequence[CutFace]) -> Layer | None:
    faces = [face for face in faces if len(face.points)]
    if not faces:
        return None
    span = max(charts.span_of(face.deviation, face.tolerance) for face in faces)
    share = min(1.0, FACE_POINTS / sum(len(face.points) for face in faces))
    points, colours = [], []
    for face in faces:
        some = np.unique(
            np.linspace(0, len(face.points) - 1, max(1, int(share * len(face.points)))).astype(int)
        )
        if np.isfinite(face.deviation).any():
            some = np.union1d(some, [int(np.nanargmax(np.abs(face.deviation)))])
        value = face.deviation[some]
        points.append(face.points[some])
        shown = charts.diverging(np.nan_to_num(value), span)
        colours.append(np.where(np.isfinite(value)[:, None], shown, charts.MISSED_COLOUR))
    area = np.concatenate([face.area for face in faces])
    spacing = float(np.sqrt(np.mean(area) / share)) if len(area) else 0.0
    bound = [face.tolerance for face in faces if not len(face.allowed)]
    limit = min(bound, default=np.inf) / MM  # where it differs from place to place, no mark says it
    high = span / MM
    key = charts.diverging(np.linspace(-high, high, SHADES), high)
    marks = tuple((sign * limit, "allowed") for sign in (-1.0, 1.0) if limit <= high)
    worse = max(faces, key=lambda face: face.largest)
    words = (
        f"largest: {worse.largest / MM:.3f} mm, {worse.title}; root mean square there "
        f"{worse.rms / MM:.3f} mm, allowed {markup.allowed(worse.allowed, worse.tolerance)} mm"
    ) + (f"; {len(faces)} faces" if len(faces) > 1 else "")
    kinds = [
        (words.negative, words.positive, words.missing)
        for words in (face_words(problem, face) for face in faces)
    ]
    blue, red, missed = (" or ".join(dict.fromkeys(words)) for words in zip(*kinds, strict=True))
    title = f"deviation from the wanted part: blue {blue}, red {red}, violet {missed}"
    return Layer(
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
