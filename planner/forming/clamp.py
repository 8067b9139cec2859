"""The clamp of the sheet as tools meet it: bars around the opening, above and below. A forming head is a body
of revolution, so where its axis is given, whatever the arm does, it is in the clamp or it is not."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.forming.tilt import leaned
from planner.forming.values import FloatArray, IntArray, Pass, ToolPath
from planner.geometry.vectors import dots
from planner.issues import Issue
from planner.problem import Stock
from planner.sheet_file import BARS
from planner.units import MM

SPACING: Final = 2e-3
"""Tools are looked at each time that they have gone so far [m]."""
ROOM: Final = 12e-3
"""What a head that may lean as it likes keeps from the clamp [m], a little more than arms keep by default."""
SLACK: Final = 1.0
"""Openings that are advised are wider by this [mm]: tools are looked at in places."""
AROUND: Final = 32
_ROUNDS: Final = 9
_CHUNK: Final = 500


@dataclasses.dataclass(frozen=True)
class Clamp:
    """K bars: a place is in one of them where it is farther out than ``reach`` (K,) [m] along ``outward``
    (K, 2) in the sheet's plane and between ``low`` and ``high`` (K,) [m] along z. Their width is not asked:
    nothing comes in from outside."""

    outward: FloatArray
    reach: FloatArray
    low: FloatArray
    high: FloatArray


def clamp_of(stock: Stock) -> Clamp:
    """The clamp of a sheet: the boxes of its support, whose y axes point inward."""
    bars = [shape for shape in stock.support if shape.kind == "box"]
    outward = np.array([-bar.pose[:2, 1] for bar in bars]).reshape(-1, 2)
    middle = np.array([bar.pose[:3, 3] for bar in bars]).reshape(-1, 3)
    size = np.array([bar.size for bar in bars]).reshape(-1, 3)
    reach = dots(middle[:, :2], outward) - 0.5 * size[:, 1]
    return Clamp(outward, reach, middle[:, 2] - 0.5 * size[:, 2], middle[:, 2] + 0.5 * size[:, 2])


def clear_lean(
    clamp: Clamp, place: FloatArray, normal: FloatArray, lean: FloatArray, profile: FloatArray
) -> FloatArray:
    """Largest angles (N,) [rad] from the vertical, up to ``lean`` (N,), at which a head below the sheet, its
    TCP at ``place`` (N, 3) [m] and leaning in the plane of the vertical and ``normal`` (N, 3), keeps
    ``ROOM`` from the clamp; 0 where none does. ``profile`` (K, 2) [m] is the head's outline."""
    out = lean.copy()
    rows = np.flatnonzero(~_clear(clamp, place, leaned(normal, lean), profile))
    low, high = np.zeros(len(rows)), lean[rows]
    for _ in range(_ROUNDS):
        middle = 0.5 * (low + high)
        good = _clear(clamp, place[rows], leaned(normal[rows], middle), profile)
        low, high = np.where(good, middle, low), np.where(good, high, middle)
    out[rows] = low
    return out


def clamp_issues(
    one: Pass, path: ToolPath, clamp: Clamp, arms: Sequence[str], profiles: Sequence[FloatArray]
) -> tuple[Issue, ...]:
    """Issues (forming.clamp) of the heads of a pass that stand in the clamp, the forming one first in
    ``arms`` and ``profiles`` (K, 2) [m]: the deepest place of each."""
    tools = [(path.former, path.axis)]
    if path.support is not None and path.support_axis is not None:
        tools.append((path.support, path.support_axis))
    issues = []
    for (place, axis), arm, profile in zip(tools, arms, profiles, strict=False):
        travel = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(place, axis=0), axis=1))])
        rows = np.flatnonzero(np.diff(np.floor(travel / SPACING), prepend=-1.0) > 0.0)
        rows = rows[~_clear(clamp, place[rows], axis[rows], profile, 0.0)]
        deep, where = _deepest(clamp, place[rows], axis[rows], profile)
        if len(rows) and deep.max() > 0.0:
            k = int(np.argmax(deep))
            wider = wider_mm(float(deep[k]) / MM, len(clamp.reach) > 8)
            issues.append(_issue(one, arm, float(deep[k]), where[k], int(rows[k]), wider))
    return tuple(issues)


def wider_mm(deep: float, rounded: bool) -> float:
    """How much wider [mm] an opening must be for tools that reach ``deep`` [mm] into its clamp; the bars of a
    ``rounded`` one are nearer to its middle than its radius."""
    return 2.0 * deep / (np.cos(np.pi / BARS) if rounded else 1.0) + SLACK


def _clear(
    clamp: Clamp, place: FloatArray, axis: FloatArray, profile: FloatArray, room: float = ROOM
) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Whether heads (N,) surely keep ``room`` [m] from the clamp: the circles that they are made of reach
    r sqrt(1 - (a u)^2) along a direction u, with the axis a."""
    back, radius = _circles(profile)
    out = np.ones(len(place), dtype=np.bool_)
    rows = np.flatnonzero(_near(clamp, place, axis, profile, room))
    for some in np.split(rows, range(_CHUNK, len(rows), _CHUNK)):
        middle = place[some, None] - back[None, :, None] * axis[some, None]
        aside = np.sqrt(np.maximum(1.0 - (axis[some, :2] @ clamp.outward.T) ** 2, 0.0))
        most = middle[..., :2] @ clamp.outward.T + radius[None, :, None] * aside[:, None]
        up = radius * np.sqrt(np.maximum(1.0 - axis[some, 2:] ** 2, 0.0))
        over = middle[..., 2, None] + up[..., None] > clamp.low - room
        under = middle[..., 2, None] - up[..., None] < clamp.high + room
        out[some] = ~((most > clamp.reach - room) & over & under).any(axis=(1, 2))
    return out


def _near(
    clamp: Clamp, place: FloatArray, axis: FloatArray, profile: FloatArray, room: float
) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Whether cylinders (N,) around heads come as near as ``room`` [m] to a bar of the clamp: whether some
    part of their axes is far enough out and as high as the bar."""
    wide = float(profile[:, 1].max())
    aside = np.sqrt(np.maximum(1.0 - (axis[:, :2] @ clamp.outward.T) ** 2, 0.0))
    up = np.sqrt(np.maximum(1.0 - axis[:, 2:] ** 2, 0.0))
    out = place[:, :2] @ clamp.outward.T + wide * aside - (clamp.reach - room)
    over = place[:, 2:] + wide * up - (clamp.low - room)
    under = clamp.high + room - place[:, 2:] + wide * up
    rise = np.broadcast_to(axis[:, 2:], over.shape)
    first = np.full(out.shape, profile[0, 0])
    last = np.full(out.shape, profile[-1, 0])
    # each of the three is positive where b * slope < value, b behind the TCP
    for value, slope in ((out, axis[:, :2] @ clamp.outward.T), (over, rise), (under, -rise)):
        bound = value / np.where(np.abs(slope) < 1e-12, 1e-12, slope)
        last = np.where(slope >= 0.0, np.minimum(last, bound), last)
        first = np.where(slope < 0.0, np.maximum(first, bound), first)
    return np.asarray((first <= last).any(axis=1))


def _deepest(
    clamp: Clamp, place: FloatArray, axis: FloatArray, profile: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """How far (N,) [m] heads reach out under or over the clamp's bars within their heights, and the places
    (N, 3) [m] that do; by places around their circles."""
    back, radius = _circles(profile)
    turn = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    deep, where = np.zeros(len(place)), np.zeros((len(place), 3))
    for k in range(len(place)):
        one = np.cross(axis[k], [0.0, 1.0, 0.0] if abs(axis[k, 1]) < 0.9 else [1.0, 0.0, 0.0])
        one /= np.linalg.norm(one)
        ring = np.cos(turn)[:, None] * one + np.sin(turn)[:, None] * np.cross(axis[k], one)
        points = (place[k] - back[:, None] * axis[k])[:, None] + radius[:, None, None] * ring
        points = points.reshape(-1, 3)
        past = points[:, :2] @ clamp.outward.T - clamp.reach
        inside = (points[:, 2, None] > clamp.low) & (points[:, 2, None] < clamp.high)
        past = np.where(inside, past, 0.0).max(axis=1, initial=0.0)
        deep[k], where[k] = past.max(), points[int(np.argmax(past))]
    return deep, where


def _circles(profile: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places behind the TCP and radii (J,) [m] of the circles by which a head is looked at."""
    even = np.arange(profile[0, 0], profile[-1, 0], SPACING)
    back = np.concatenate([even, profile[:, 0]])
    radius = np.concatenate([np.interp(even, profile[:, 0], profile[:, 1]), profile[:, 1]])
    rows: IntArray = np.flatnonzero(radius > 0.0)
    return back[rows], radius[rows]


def _issue(one: Pass, arm: str, deep: float, point: FloatArray, index: int, wider: float) -> Issue:
    x, y, z = (float(value) / MM for value in point)
    return Issue(
        "forming.clamp",
        f"pass {one.name}: the tool of {arm} reaches {deep / MM:.1f} mm into the clamp at ({x:.1f}, {y:.1f}, "
        f"{z:.1f}) mm, allowed is 0",
        field="sheet.opening_mm",
        arm=arm,
        index=index,
        value=deep / MM,
        limit=0.0,
        unit="mm",
        hint=f"make the opening {wider:.1f} mm wider and twice settings.clearance_mm besides; or "
        "take a slimmer tool or a smaller disk, let the tool lean less, or make the clamp's bars lower",
    )
