"""Tools that keep clear of the clamp, and a supporting ball that keeps clear of what is formed.

**Clamp** of the sheet as tools meet it: bars around the opening, above and below. A forming head is
a body of revolution, so where its axis is given, whatever the arm does, it is in the clamp or it is
not.

**Supporting ball** that does not cut into what is formed already: it is turned about the forming
ball. Opposite the forming ball along the face's normal, a ball that is larger than a hollow of the
sheet's far face (the bend from the flat into the wall, a groove where two walls meet) would cut
into it. Turned toward straight below, it comes clear: there it is lower than anything that is
formed. So the largest angle from the vertical is sought at which it is clear, by halving; the
distance of the balls stays.
"""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.geometry.mesh import small_pieces
from planner.geometry.units import DEG, MM, measurement
from planner.issues import Issue, Severity
from planner.problem import Stock
from planner.processes.forming.plan.contact import ContactPath, Pass, ToolPath
from planner.processes.forming.plan.support.directions import leaned
from planner.reading.sheet import CLAMP_BARS

FACE_SPACING: Final = 1e-3
"""Distance [m] of points on the face and of places on a tool's way."""
REACHED_WITHIN: Final = 1.5e-4
"""What the forming ball comes so near [m] to is formed by it, but for what is left."""
MOST_POINTS: Final = 100_000
"""Pieces at most into which a face is divided for its points,"""
FIRST_POINTS: Final = 10_000
"""so many of them for a first look, which is of few targets, some degrees of the support's turn apart."""
_TILT_HALVINGS: Final = 9
"""Halvings by which the largest tilt of a support is found that clears the sheet."""
_PLACES_AT_ONCE: Final = 4000
"""Places of a support that are looked at at once."""
_FLAT_HEIGHT: Final = 2e-5
"""Points higher than a place by less than this [m] are on the same flat."""
TURNED_ANGLE: Final = 2.0 * DEG
"""A warning is due where the support is turned by more than this [rad] ..."""
TURNED_SHARE: Final = 0.02
"""... on more than this share of the way."""
RADIUS_STEP: Final = 1e-5
"""Radii [m] are told to this: one that is no smaller is none to take."""
"""A warning is given where the support is turned by more than the angle on more than the share of the way."""


class FarFace:
    """Points of the sheet's far face of a pass formed from above: those over which the forming ball of
    ``radius`` [m] comes on its way, and the flat around. Corners too narrow for it are not formed, so what is
    behind them in the wanted part is not there. ``thickness`` [m] of the sheet; ``most``: pieces of it."""

    def __init__(
        self, one: Pass, thickness: float, contact: ContactPath, radius: float, most: int = MOST_POINTS
    ) -> None:
        pieces, _ = small_pieces(one.vertices[one.faces], FACE_SPACING, most)
        near = np.concatenate([pieces.mean(axis=1), one.vertices])
        apart = cKDTree(_along(contact)).query(near, distance_upper_bound=radius + REACHED_WITHIN)[0]
        flat = near[:, 2] >= one.start - _FLAT_HEIGHT
        near, self._short = near[np.isfinite(apart) | flat], np.where(flat, 0.0, apart - radius)
        self._short = np.maximum(self._short[np.isfinite(self._short)], 0.0)
        self._level = near[:, 2]
        self._points = near - np.array([0.0, 0.0, thickness])
        self._tree = cKDTree(self._points)

    def cuts(self, place: FloatArray, radius: FloatArray, above: FloatArray) -> BoolArray:
        """Whether balls of ``radius`` (M,) [m] about ``place`` (M, 3) hold points of what is formed: what is
        higher than ``above`` (M,) [m] on the near face."""
        out = np.zeros(len(place), dtype=np.bool_)
        for start in range(0, len(place), _PLACES_AT_ONCE):
            some = slice(start, start + _PLACES_AT_ONCE)
            most = float(radius[some].max())
            found = cKDTree(place[some]).sparse_distance_matrix(self._tree, most, output_type="ndarray")
            i, j = found["i"], found["j"]
            hit = (found["v"] < radius[some][i] - self._short[j]) & (
                self._level[j] > above[some][i] + _FLAT_HEIGHT
            )
            out[start + i[hit]] = True
        return out

    def largest(self, touch: FloatArray, line: FloatArray, above: FloatArray, most: float) -> float:
        """Largest radius [m], up to ``most``, of a ball that touches the far face at every one of ``touch``
        (M, 3), its centre along -``line`` (M, 3) from there, and holds no point of what is formed."""
        best = most
        for start in range(0, len(touch), _PLACES_AT_ONCE):
            some = slice(start, start + _PLACES_AT_ONCE)
            found = cKDTree(touch[some]).sparse_distance_matrix(self._tree, 2.0 * best, output_type="ndarray")
            i, j = found["i"], found["j"]
            kept = (self._level[j] > above[some][i] + _FLAT_HEIGHT) & (found["v"] > 2.0 * FACE_SPACING)
            i, j, far = i[kept], j[kept], found["v"][kept]
            ahead = -dots(self._points[j] - touch[some][i], line[some][i])
            fits = ahead > 1e-3 * far
            if fits.any():
                best = min(best, float((far[fits] ** 2 / (2.0 * ahead[fits])).min()))
        return best


def _along(contact: ContactPath) -> FloatArray:
    """Places of the forming ball's centre on its way, a point's spacing apart."""
    length = np.linalg.norm(np.diff(contact.centre, axis=0), axis=1)
    count = np.where(contact.working[1:], np.maximum(np.ceil(length / FACE_SPACING), 1), 1).astype(np.int64)
    row = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)) / count[row]
    step = contact.centre[row + 1] - contact.centre[row]
    return np.concatenate([contact.centre[row] + share[:, None] * step, contact.centre[-1:]])


def clear_tilt(
    face: FarFace, contact: ContactPath, tilt: FloatArray, apart: FloatArray, radius: FloatArray
) -> FloatArray:
    """Largest angles (N,) [rad] from the vertical, up to ``tilt`` (N,), at which balls of ``radius`` (N,)
    [m], ``apart`` (N,) [m] below the centres of the forming ball, are clear of what is formed."""
    out = tilt.copy()

    def wrong(rows: IntArray, angle: FloatArray) -> BoolArray:
        place = contact.centre[rows] - apart[rows, None] * leaned(contact.normal[rows], angle)
        return face.cuts(place, radius[rows], contact.point[rows, 2])

    rows = np.flatnonzero(wrong(np.arange(len(tilt)), tilt))
    low, high = np.zeros(len(rows)), tilt[rows]
    for _ in range(_TILT_HALVINGS):
        middle = 0.5 * (low + high)
        bad = wrong(rows, middle)
        low, high = np.where(bad, low, middle), np.where(bad, middle, high)
    out[rows] = low
    return out


def radius_issue(
    one: Pass,
    thickness: float,
    contact: ContactPath,
    wanted: FloatArray,
    off: FloatArray,
    gap: FloatArray,
    radii: FloatArray,
    slack: float,
) -> Issue | None:
    """A warning (forming.support_radius) where the support is turned away from opposite by ``off`` (N,) [rad]
    too often, beyond where the flat around the feature makes it, as it would else cut into what is formed
    by more than ``slack`` [m]. ``wanted`` (N,) [rad]: the angle from the vertical that would be opposite;
    ``thickness`` [m] of the flat sheet; ``gap`` (N,) [m]; ``radii`` (2,) [m] of the forming ball and the
    support."""
    deep = one.start - contact.point[:, 2] > radii[1] * (1.0 - np.cos(contact.angle)) + 2e-4
    wrong = deep & (off > TURNED_ANGLE) & contact.working
    rows = np.flatnonzero(wrong)
    if not len(rows):
        return None
    # the line is turned also where what the ball leans on changes at once; no smaller support changes that
    face = FarFace(one, thickness, contact, float(radii[0]))
    line = leaned(contact.normal[rows], wanted[rows])
    place = contact.centre[rows] - (radii.sum() + gap[rows])[:, None] * line
    squeezed = np.maximum(thickness * np.cos(contact.angle[rows]) - gap[rows], 0.0)
    wrong[rows] = face.cuts(place, radii[1] - squeezed - slack, contact.point[rows, 2])
    way = np.linalg.norm(np.diff(contact.centre, axis=0, prepend=contact.centre[:1]), axis=1)
    share = float(way[wrong].sum()) / max(float(way[deep].sum()), 1e-9)
    if share <= TURNED_SHARE:
        return None
    touch = contact.centre[wrong] - (radii[0] + gap[wrong])[:, None] * contact.normal[wrong]
    fits = face.largest(touch, contact.normal[wrong], contact.point[wrong, 2], float(radii[1]))
    at = contact.point[np.flatnonzero(wrong)[int(np.argmax(off[wrong]))]] / MM
    what = (
        f"pass {one.name}: on {100.0 * share:.0f} % of the way the supporting ball of {radii[1] / MM:.2f} mm "
        f"radius cannot be opposite the forming one, most at ({at[0]:.1f}, {at[1]:.1f}, {at[2]:.1f}) mm; it "
        f"is turned aside by up to {float(off[wrong].max()) / DEG:.0f} deg"
    )
    known = fits < radii[1] - RADIUS_STEP
    return Issue(
        "forming.support_radius",
        f"{what}; the largest that fits is {fits / MM:.2f} mm" if known else what,
        Severity.WARNING,
        **measurement(float(radii[1]) / MM, fits / MM if known else None, "mm"),
        hint="take a smaller supporting tool, or round the part more" if known else "round the part there",
    )


CLAMP_SPACING: Final = 2e-3
"""Tools are looked at each time that they have gone so far [m]."""
LEANING_ROOM: Final = 12e-3
"""What a head that may lean as it likes keeps from the clamp [m], a little more than arms keep by default."""
OPENING_SPARE_MM: Final = 1.0
"""Openings that are advised are wider by this [mm]: tools are looked at in places."""
CIRCLE_PLACES: Final = 32
"""Places around a circle of a tool that are held against the clamp."""
_LEAN_HALVINGS: Final = 9
"""Halvings by which the largest lean of a tool is found that clears the clamp."""
_CLAMP_PLACES_AT_ONCE: Final = 500
"""Places of a tool's tip that are held against the clamp at once."""


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
    ``LEANING_ROOM`` from the clamp; 0 where none does. ``profile`` (K, 2) [m] is the head's outline."""
    out = lean.copy()
    rows = np.flatnonzero(~_clear(clamp, place, leaned(normal, lean), profile))
    low, high = np.zeros(len(rows)), lean[rows]
    for _ in range(_LEAN_HALVINGS):
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
        rows = np.flatnonzero(np.diff(np.floor(travel / CLAMP_SPACING), prepend=-1.0) > 0.0)
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
    return 2.0 * deep / (np.cos(np.pi / CLAMP_BARS) if rounded else 1.0) + OPENING_SPARE_MM


def _clear(
    clamp: Clamp, place: FloatArray, axis: FloatArray, profile: FloatArray, room: float = LEANING_ROOM
) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Whether heads (N,) surely keep ``room`` [m] from the clamp: the circles that they are made of reach
    r sqrt(1 - (a u)^2) along a direction u, with the axis a."""
    back, radius = _circles(profile)
    out = np.ones(len(place), dtype=np.bool_)
    rows = np.flatnonzero(_near(clamp, place, axis, profile, room))
    for some in np.split(rows, range(_CLAMP_PLACES_AT_ONCE, len(rows), _CLAMP_PLACES_AT_ONCE)):
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
    turn = np.linspace(0.0, 2.0 * np.pi, CIRCLE_PLACES, endpoint=False)
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
    even = np.arange(profile[0, 0], profile[-1, 0], CLAMP_SPACING)
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
        **measurement(deep / MM, 0.0, "mm"),
        hint=f"make the opening {wider:.1f} mm wider and twice settings.clearance_mm besides; or "
        "take a slimmer tool or a smaller disk, let the tool lean less, or make the clamp's bars lower",
    )
