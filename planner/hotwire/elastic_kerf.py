"""The kerf along a bent wire: where it moves slower its slot is wider, and half of that is the offset."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.claims import KerfCurve
from planner.hotwire.elastic_path import Face
from planner.hotwire.elastic_wires import box_distance
from planner.hotwire.operation import ElasticWire
from planner.issues import Issue, TandemError
from planner.targets import FEED_SHARE
from planner.units import MM

FloatArray = NDArray[np.float64]

PLACES = 160
"""Places along the sweep at which speeds along the wire are worked out."""


MELTED = 1e-3
"""[m] what the wire does on less of its way either way is melted together: stops are not told."""
FACTORS = np.geomspace(1.0 / 8.0, 8.0, 61)
"""Powers and feeds that are looked at where a slot is too wide or too narrow, as multiples."""
FASTEST = 50.0
"""[mm/s] no feed beyond this is named."""


def is_constant(curve: KerfCurve) -> bool:
    """Whether the slot has one width at every speed."""
    return bool(np.ptp(curve.width) == 0.0)


def speed_shares(face: Face, box: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (P, S, 3) [m] of a face's wires over its sweep, and how fast (P, S) each moves across the wire,
    as a share of the fastest point inside the block ``box`` (2, 3); of the fastest of all outside."""
    p = np.linspace(face.family.lower, face.family.upper, PLACES)
    wires = face.wires(p)
    points = wires.points(wires.shapes())
    way = np.gradient(points, p, axis=0)
    along = np.gradient(points, axis=1)
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    across = np.linalg.norm(way - np.sum(way * along, axis=2, keepdims=True) * along, axis=2)
    inside = box_distance(points, box) < 0.0
    inside |= ~inside.any(axis=1, keepdims=True)
    fastest = np.max(np.where(inside, across, 0.0), axis=1, keepdims=True)
    return points, across / np.maximum(fastest, 1e-12)


def speeds(face: Face, vertices: FloatArray, feed: float, box: FloatArray) -> FloatArray:
    """Speeds (V,) [m/s] of the wire where it passes vertices (V, 3) of a face, its fastest point moving at
    ``feed`` [m/s]."""
    points, share = speed_shares(face, box)
    distance, nearest = cKDTree(points.reshape(-1, 3)).query(vertices, k=4)
    weight = 1.0 / np.maximum(distance, 1e-9)
    local = np.sum(weight * share.reshape(-1)[nearest], axis=1) / weight.sum(axis=1)
    return np.asarray(feed * local)


def widths(face: Face, vertices: FloatArray, curve: KerfCurve, feed: float, box: FloatArray) -> FloatArray:
    """Width (V,) [m] of the slot at the vertices (V, 3) of a face whose fastest point moves at ``feed``
    [m/s]."""
    return curve.at(speeds(face, vertices, feed, box))


@dataclasses.dataclass(frozen=True)
class Passed:
    """A face's name with vertices (V, 3) [m] and the wire's speed (V,) [m/s] there."""

    name: str
    vertices: FloatArray
    speed: FloatArray


def check_heat(op: ElasticWire, passed: list[Passed], curve: KerfCurve) -> list[Issue]:
    """``kerf.too_hot`` and ``kerf.too_cold`` where the slot of an operation with a power leaves the range."""
    if op.power_w is None:
        return []
    low, high = op.kerf_range_mm
    out = []
    for one in passed:
        width = curve.at(one.speed) / MM
        for code, k, limit, does in (
            ("kerf.too_hot", int(np.argmax(width)), high, "burns the foam"),
            ("kerf.too_cold", int(np.argmin(width)), low, "drags: it is too cold"),
        ):
            if (width[k] > limit) if code == "kerf.too_hot" else (width[k] < limit):
                place = ", ".join(f"{value:.1f}" for value in one.vertices[k] / MM)
                what = (
                    f"{op.name}: on cut/{one.name} the wire, at {one.speed[k] / MM:.2f} mm/s at [{place}] mm "
                    f"while its fastest point is at {FEED_SHARE * op.feed_mm_s:.3g} mm/s, melts "
                    f"{width[k]:.2f} mm and {does}; allowed are {low:g} to {high:g} mm"
                )
                value = float(width[k])
                out.append(Issue(code, what, field="operations.power_w", value=value, limit=limit, unit="mm"))
    return out


def check_driven(
    op: ElasticWire, here: Passed, curve: KerfCurve, edge: FloatArray, clock: FloatArray, spare: float
) -> list[Issue]:
    """``kerf.too_hot`` where the arms drive the wire so much slower than its feed that the slot leaves its
    range, or more of the face than may be is off by over ``spare`` [m].

    ``here`` has the speeds that the face was offset for; ``edge`` (N, P, 3) [m] are the wires from the target
    before the face to its last one, ``clock`` (2, N) how far the fastest point has come there [m] and when
    [s].
    """
    gone, time = clock
    ends = np.clip(np.stack([gone - MELTED, gone + MELTED]), gone[0], gone[-1])
    way, took = ends[1] - ends[0], np.interp(ends[1], gone, time) - np.interp(ends[0], gone, time)
    slow = np.clip(way / np.maximum(took, 1e-9) / (FEED_SHARE * op.feed_mm_s * MM), 1e-3, 1.0)
    vertices = here.vertices
    slow = slow[cKDTree(edge.reshape(-1, 3)).query(vertices)[1] // edge.shape[1]]
    width = curve.at(slow * here.speed)
    more = 0.5 * (width - curve.at(here.speed))
    high = op.kerf_range_mm[1] * MM
    limit = np.minimum(high, width - 2.0 * (more - spare))
    if width.max() <= high and (more > spare).mean() <= 1.0 - op.share:
        return []
    k = int(np.argmax(width - limit))
    place = ", ".join(f"{value:.1f}" for value in vertices[k] / MM)
    held = np.floor(100.0 * FEED_SHARE * op.feed_mm_s * slow.min()) / 100.0
    hint = f"feed_mm_s: {held:g}, which the arms hold all along; check then says which power fits"
    if held < op.feed_min_mm_s:
        hint = "let the panel twist less, or move the arms so that they turn less (place: auto, base: auto)"
    what = (
        f"{op.name}: on cut/{here.name} the arms drive the wire at {100.0 * slow[k]:.0f} % of its feed at "
        f"[{place}] mm, which is as fast as they may; it melts {width[k] / MM:.2f} mm there, allowed are "
        f"{limit[k] / MM:.2f} mm"
    )
    measure = {"value": float(width[k] / MM), "limit": float(limit[k] / MM), "unit": "mm"}
    return [Issue("kerf.too_hot", what, field="operations.feed_mm_s", hint=hint, **measure)]  # type: ignore[arg-type]


def advice(
    op: ElasticWire,
    passed: list[Passed],
    curve_of: Callable[[ElasticWire], KerfCurve],
    tried: Callable[[ElasticWire], list[Issue]],
) -> str:
    """A power, and a feed, at which all slots are within the range, ``tried`` on cuts made anew; or that
    there is none."""
    said = []
    for key, own in (("power_w", op.power_w or 0.0), ("feed_mm_s", op.feed_mm_s)):
        good = [value for value in own * FACTORS if not _faults(_with(op, key, value), op, passed, curve_of)]
        for digits in (2, 3):
            value = float(f"{np.sqrt(good[0] * good[-1]):.{digits}g}") if good else 0.0
            changed = _with(op, key, value)
            if good and not _faults(changed, op, passed, curve_of) and not tried(changed):
                said.append(f"{key}: {value:g}")
                break
    if said:
        return f"{' or '.join(said)}, as was tried"
    return (
        "no power and no feed that was tried holds all of the face: let the wire's points move more alike "
        "(another sweep, a panel that twists less), or allow more in kerf_range_mm"
    )


def _with(op: ElasticWire, key: str, value: float) -> ElasticWire:
    return op.model_copy(update={key: value})


def _faults(
    changed: ElasticWire,
    op: ElasticWire,
    passed: list[Passed],
    curve_of: Callable[[ElasticWire], KerfCurve],
) -> bool:
    """Whether another power or feed does not do at the speeds as they are, or is none."""
    faster = changed.feed_mm_s / op.feed_mm_s
    if not op.feed_min_mm_s <= changed.feed_mm_s <= FASTEST:
        return True
    try:
        curve = curve_of(changed)
    except TandemError:  # a power that melts the wire, and the like
        return True
    moved = [dataclasses.replace(one, speed=faster * one.speed) for one in passed]
    return bool(check_heat(changed, moved, curve))
