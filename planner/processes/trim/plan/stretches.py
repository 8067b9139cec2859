"""From closed curves to the stretches that a knife cuts between going into the sheet and coming out of it.

A blade stands in the plane of its curve. At a corner that is sharper than it can turn through, at a
micro-joint, and where its heading has turned by as much as it may, it is lifted out of the sheet, turned
and put in again. Behind its tip it has a straight end, before it its edge goes up and forward: so it is put
in and taken out that far from the ends of a stretch, and cuts past a corner at the near face alone.
"""

import dataclasses
from typing import Final, Literal

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, dots, unit
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, refusal
from planner.processes.trim.claims import MOST_STRETCHES
from planner.processes.trim.plan.cutting import Cutting
from planner.processes.trim.plan.face import Face, Laid, apart
from planner.processes.trim.plan.operation import KnifeCut, Trim
from planner.processes.trim.plan.slots import Slot, Wanted
from planner.tooling import Blade

OVERLAP: Final = 0.1 * MM
"""How much farther than to a corner a stretch is cut [m], so that it meets the next one there."""
OVERLAP_SHARE: Final = 0.3
"""The same at most as a share of the tolerance."""
CLOSING: Final = 0.5 * MM
"""The same where a smooth curve closes, or is cut in pieces [m]."""
LEAST_STROKE: Final = 0.2 * MM
"""The way [m] that a knife goes in a stretch that is shorter than its blade."""
PLAN_TURN: Final = 1.0 * DEG
"""Where a curve turns by less than this at a place, seen from above, there is no corner [rad]."""
HEADING_REACH: Final = (0.3 * MM, 1.5 * MM)
"""Half the length of the chords whose direction a blade has: that of its own, within these [m]."""
NORMAL_REACH: Final = 2.0 * MM
"""A blade stands square to the face as it is, in the mean, over so much of the curve either way [m],"""
NORMAL_PLACES: Final = 17
"""by so many places;"""
LEAN_SHARE: Final = 0.5
"""it leans off the face at its own place by this share of its cone at most for that,"""
FAR_SHARE: Final = 0.4
"""and is off its curve at the far face by this share of the tolerance at most."""
BESIDE_SHARE: Final = 0.5
"""Share of the tolerance by which front and back of a blade may be off its curve where that is bent."""
BLADE_PLACES: Final = 9
"""Places along a blade at which it is held against its curve."""
JOINT_STARTS: Final = 48
"""Places at which micro-joints are tried to begin, so that they are off all corners."""
TURN_STEP: Final = 80.0 * DEG
"""How far a knife turns on one move in the air at most [rad]."""

End = Literal["corner", "joint", "piece"]
"""What a stretch ends at: a corner, a micro-joint, or a place where the curve goes on smoothly."""


@dataclasses.dataclass(frozen=True)
class _Span:
    """A stretch of a curve from ``low`` to ``high`` [m] along it."""

    low: float
    high: float
    begins: End
    ends: End


def ahead(axis: FloatArray, heading: FloatArray) -> FloatArray:
    """Directions (N, 3) at right angles to ``axis`` (N, 3) that have, seen from above, a ``heading`` (N,)
    [rad]."""
    flat = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    rise = np.copysign(np.maximum(np.abs(axis[:, 2]), 0.02), axis[:, 2])
    return unit(np.column_stack([flat, -dots(flat, axis[:, :2]) / rise]))


def corners(laid: Laid, least: float) -> FloatArray:
    """Where along a curve (C,) [m] it turns, on its face, by more than ``least`` [rad] at one place."""
    flat = laid.point[:, :2]
    after = unit(np.roll(flat, -1, axis=0) - flat)
    before = np.roll(after, 1, axis=0)
    plan = np.abs(np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], dots(before, after)))
    one, other = (ahead(laid.normal, np.arctan2(way[:, 1], way[:, 0])) for way in (before, after))
    turn = np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), dots(one, other))
    return np.asarray(laid.along[:-1][(plan > PLAN_TURN) & (turn > least)])


class _Ring:
    """A closed curve by the way along it, with the ``corners`` at which its stretches end."""

    def __init__(self, laid: Laid, face: Face, sharp: FloatArray) -> None:
        self.laid, self.face, self.corners, self.length = laid, face, sharp, laid.length
        self._points = np.concatenate([laid.point, laid.point[:1]])

    def at(self, along: FloatArray, span: _Span) -> FloatArray:
        """Places (N, 3) ``along`` (N,) [m] a stretch: past corners and joints straight on."""
        low = -np.inf if span.begins == "piece" else span.low
        high = np.inf if span.ends == "piece" else span.high
        out = self._on(np.clip(along, low, high))
        for end, beyond, inner in (
            (low, np.minimum(along - low, 0.0), 1e-5),
            (high, np.maximum(along - high, 0.0), -1e-5),
        ):
            if np.isfinite(end) and np.any(beyond):
                way = (self._on(np.array([end + inner])) - self._on(np.array([end]))) / inner
                out = out + beyond[:, None] * unit(way)
        return self.face.at(out[:, :2])[0]

    def _on(self, along: FloatArray) -> FloatArray:
        place = along % self.length
        return np.stack([np.interp(place, self.laid.along, self._points[:, k]) for k in range(3)], axis=1)

    def headings(self, along: FloatArray, span: _Span, reach: float) -> FloatArray:
        """Directions (N,) [rad], seen from above, of the chords that go ``reach`` [m] either way, but not
        past corners and joints."""
        low = along - reach if span.begins == "piece" else np.clip(along - reach, span.low, span.high)
        high = along + reach if span.ends == "piece" else np.clip(along + reach, span.low, span.high)
        short = high - low < reach
        low, high = np.where(short & (along > span.high - reach), high - reach, low), high
        high = np.where(short & (along < span.low + reach), low + reach, high)
        way = self.at(high, span) - self.at(low, span)
        return np.unwrap(np.arctan2(way[:, 1], way[:, 0]))

    def normals(self, along: FloatArray, span: _Span, most: float) -> FloatArray:
        """Mean normals (N, 3) of the face over ``NORMAL_REACH`` either way, the nearer the more, so that they
        turn evenly where the face begins to bend: off its own by no more than ``most`` [rad]."""
        own = self.face.at(self.at(along, span)[:, :2])[1]
        share = np.linspace(-1.0, 1.0, NORMAL_PLACES)
        for reach in NORMAL_REACH * 0.5 ** np.arange(4):
            places = self.at((along[:, None] + reach * share).ravel(), span)
            some = self.face.at(places[:, :2])[1].reshape(len(along), NORMAL_PLACES, 3)
            mean = unit(np.einsum("k,nkd->nd", 1.0 - np.abs(share) + 1e-3, some))
            if float(dots(mean, own).min()) >= np.cos(most):
                return mean
        return own

    def bent(self, along: float, end: float, span: _Span, thickness: float) -> float:
        """How far apart [m] at the far face, ``thickness`` [m] behind, normals at two places are more than at
        the near one: by so much a stretch is longer that is to reach its corner there, too."""
        one, other = self.face.at(self.at(np.array([along, end]), span)[:, :2])[1]
        turn = float(np.arccos(np.clip(one @ other, -1.0, 1.0)))
        return 1.5 * thickness * min(turn, 0.5 * np.pi)

    def between(self, low: float, high: float) -> FloatArray:
        """Its own places [m] along it from ``low`` to ``high``, with both of these."""
        turns = np.arange(np.floor(low / self.length), np.floor(high / self.length) + 1.0)
        own = (self.laid.along[:-1] + self.length * turns[:, None]).ravel()
        inner = own[(own > low + 1e-6) & (own < high - 1e-6)]
        return np.concatenate([[low], inner, [high]])


def stretches(op: Trim, one: Wanted, face: Face, tool: Cutting) -> list[Slot]:
    """The stretches of an outline, each a slot without ways in and out. Raises ``TandemError`` with
    ``trim.corner`` and ``trim.joints``."""
    by, blade = op.by, tool.blade
    if not isinstance(by, KnifeCut) or blade is None:
        raise ValueError("stretches are those of a knife")
    ring = _Ring(one.laid, face, corners(one.laid, by.turns_deg * DEG))
    long = blade.end + float(blade.front(tool.deep))
    reach = float(np.clip(0.5 * long, *HEADING_REACH))
    spans = _pieces(ring, _spans(one, ring), by.most_turn_deg * DEG, reach)
    if len(spans) > MOST_STRETCHES:
        what = f"{one.spec.name}: the blade would be lifted {len(spans)} times; allowed: {MOST_STRETCHES}"
        hint = "draw what is round as arcs or splines, not as corners, or allow larger turns_deg"
        value, limit = float(len(spans)), float(MOST_STRETCHES)
        raise refusal("trim.corner", what, value=value, limit=limit, hint=hint)
    out, issues = [], list[Issue]()
    for number, span in enumerate(spans, 1):
        name = one.spec.name if len(spans) == 1 else f"{one.spec.name}_p{number}"
        try:
            out.append(_stretch(op, by, one, ring, span, (blade, tool.deep, reach), name))
        except TandemError as error:
            issues += error.issues
    if issues:
        raise TandemError(issues)
    return out


def _spans(one: Wanted, ring: _Ring) -> list[_Span]:
    """The stretches between corners and micro-joints; a curve without either begins where its heading is
    that of -x, so that all round ones begin alike and turn by half a turn either way."""
    half, joints = 0.5 * one.spec.joint_mm * MM, _joints(one, ring)
    marks: list[tuple[float, float, End]] = [(float(at), 0.0, "corner") for at in ring.corners]
    marks = sorted([*marks, *((at, half, "joint") for at in joints)])
    if not marks:
        whole = _Span(0.0, ring.length, "piece", "piece")
        places = ring.laid.along[:-1]
        heading = ring.headings(places, whole, HEADING_REACH[0])
        start = float(places[int(np.argmin(np.cos(heading)))])
        return [_Span(start, start + ring.length, "piece", "piece")]
    out = []
    for (at, half_gap, kind), (to, other, end) in zip(marks, [*marks[1:], marks[0]], strict=True):
        far = to if to > at else to + ring.length
        out.append(_Span(at + half_gap, far - other, kind, end))
    return out


def _joints(one: Wanted, ring: _Ring) -> list[float]:
    """Middles [m] of micro-joints along a curve, off its corners as far as may be. Raises ``TandemError``
    (trim.joints)."""
    count, width = one.spec.joints, one.spec.joint_mm * MM
    if not count:
        return []
    even = ring.length * np.arange(count) / count
    shifts = ring.length / count * np.arange(JOINT_STARTS) / JOINT_STARTS
    best, room = shifts[0], np.inf
    if len(ring.corners):
        off = np.abs(even[:, None, None] + shifts[:, None] - ring.corners) % ring.length
        least = np.minimum(off, ring.length - off).min(axis=(0, 2))
        best, room = float(shifts[int(np.argmax(least))]), float(least.max())
    if ring.length / count <= 2.0 * width or room <= width:
        most = int(ring.length / (2.0 * width))
        what = f"{one.spec.name}: {count} micro-joints of {width / MM:g} mm do not fit between its corners, "
        what += "each as far off them as it is wide"
        hint = f"take fewer joints (at most {most}), or a smaller joint_mm"
        raise refusal("trim.joints", what, value=count, limit=most, hint=hint)
    return [float(at) for at in (even + best) % ring.length]


def _pieces(ring: _Ring, spans: list[_Span], most: float, reach: float) -> list[_Span]:
    """The stretches, in so many pieces that the heading of none turns by more than ``most`` [rad]."""
    out = []
    for span in spans:
        at = ring.between(span.low, span.high)
        heading = ring.headings(at, span, reach)
        cuts = _cut_at(heading, most)
        for share in np.linspace(1.0, 0.5, 26)[1:]:  # as many pieces, but more alike
            less = _cut_at(heading, share * most)
            if len(less) > len(cuts):
                break
            cuts = less
        ends = [span.low, *(float(at[k]) for k in cuts), span.high]
        kinds: list[End] = [span.begins, *["piece" for _ in cuts], span.ends]  # type: ignore[list-item]
        out += [_Span(ends[k], ends[k + 1], kinds[k], kinds[k + 1]) for k in range(len(ends) - 1)]
    return out


def _cut_at(heading: FloatArray, most: float) -> list[int]:
    """Rows at which headings (N,) [rad] have turned by ``most`` since the row before of these."""
    out, first = list[int](), 0
    for k in range(1, len(heading)):
        own = heading[first : k + 1]
        if float(np.ptp(own)) > most and k > first + 1:
            first = k - 1
            out.append(first)
    return out


def _stretch(
    op: Trim, by: KnifeCut, one: Wanted, ring: _Ring, span: _Span, tool: tuple[Blade, float, float], name: str
) -> Slot:
    """One stretch, by a ``tool``: a blade, how deep [m] it is behind the face, and the reach [m] of chords
    whose headings it has. Raises ``TandemError`` (trim.corner, trim.joints)."""
    blade, deep, reach = tool
    far, near = float(blade.front(by.below_mm * MM)), float(blade.front(deep))
    meets = min(OVERLAP, OVERLAP_SHARE * op.shape_tol_mm * MM)
    low, high = span.low, span.high + CLOSING  # where a curve goes on, its tip alone cuts all of it
    if span.begins != "piece":
        low = span.low + blade.end
        low -= (
            meets + ring.bent(low, span.low, span, deep - by.below_mm * MM)
            if span.begins == "corner"
            else 0.0
        )
    if span.ends != "piece":
        high = span.high - (near if span.ends == "joint" else far)
        high += (
            meets + ring.bent(high, span.high, span, deep - by.below_mm * MM)
            if span.ends == "corner"
            else 0.0
        )
    if high - low < LEAST_STROKE:
        if "joint" in (span.begins, span.ends):
            what = f"{name}: the stretch of {(span.high - span.low) / MM:.1f} mm beside a micro-joint is "
            what += f"shorter than the blade, {(blade.end + near) / MM:.1f} mm"
            hint = "take fewer joints, or a narrower blade"
            raise refusal("trim.joints", what, hint=hint)
        middle = 0.5 * (low + high)
        low, high = middle - 0.5 * LEAST_STROKE, middle + 0.5 * LEAST_STROKE
    along = ring.between(low, high)
    point = ring.at(along, span)
    aside = float(np.arctan2(FAR_SHARE * op.shape_tol_mm * MM, deep - by.below_mm * MM))
    normal = ring.normals(along, span, min(LEAN_SHARE * op.cone_deg * DEG, aside))
    heading = ring.headings(along, span, reach)
    middle = 0.5 * (heading.max() + heading.min())
    heading = heading - 2.0 * np.pi * np.round(middle / (2.0 * np.pi))
    over = _over(one, ring, span, (span.low - (low - blade.end), high + near - span.high))
    if over > by.overcut_mm * MM + meets + 1e-9:
        end = ring.at(np.array([span.high]), span)[0] / MM
        what = f"{name}: the blade cuts {over / MM:.2f} mm past a corner into the part, about "
        what += f"({end[0]:.1f}, {end[1]:.1f}) mm; allowed: {by.overcut_mm:g} mm"
        hint = f"allow overcut_mm: {np.ceil(10.0 * over / MM) / 10.0:g}, or take a blade that is narrower, "
        hint += f"or a below_mm of its ground_mm ({blade.ground / MM:g}), where it is as wide at both faces"
        value, limit = over / MM, by.overcut_mm
        raise refusal("trim.corner", what, value=value, limit=limit, unit="mm", hint=hint)
    slot = Slot(name, one.spec.name, point, normal, 0, len(point) - 1, heading, over)
    _require_beside(op, one, slot, along, span, (blade, near, ring.face, deep - by.below_mm * MM))
    return slot


def _over(one: Wanted, ring: _Ring, span: _Span, past: tuple[float, float]) -> float:
    """How far [m] a stretch that is cut ``past`` [m] both of its corners goes into the part there."""
    out = 0.0
    for kind, end, sign, way in (
        (span.begins, span.low, -1.0, past[0]),
        (span.ends, span.high, 1.0, past[1]),
    ):
        if kind != "corner" or way <= 0.0:
            continue
        beyond = way * np.linspace(0.0, 1.0, BLADE_PLACES)[1:]
        some = ring.at(end + sign * beyond, span)
        out = max(out, float(np.max(beyond, initial=0.0, where=~_harmless(one, some))))
    return out


def _harmless(one: Wanted, places: FloatArray) -> BoolArray:
    """(N,) whether what is cut at places is waste, or on the curve."""
    return np.asarray(one.waste(places[:, :2]) | (apart(places, one.laid.point) < 1e-6))


def _require_beside(
    op: Trim, one: Wanted, slot: Slot, along: FloatArray, span: _Span, blade: tuple[Blade, float, Face, float]
) -> None:
    """Whether front and back of the blade stay by the curve where it is bent. Raises ``TandemError``
    (trim.corner)."""
    own, near, face, thickness = blade
    before = np.linspace(-own.end, near, BLADE_PLACES)
    at = along[:, None] + before
    ways = ahead(slot.normal, slot.heading)
    places = slot.point[:, None] + before[:, None] * ways[:, None]
    inside = ((at >= span.low) | (span.begins == "piece")) & ((at <= span.high) | (span.ends == "piece"))
    places = places[inside]
    if not len(places):
        return
    # at the far face, seen from the near one: the blade stands square to the sheet at its tip alone
    turned = face.at(places[:, :2])[1] - np.repeat(slot.normal, BLADE_PLACES, axis=0)[inside.ravel()]
    places = np.concatenate([places, places + face.side * thickness * turned])
    off = np.where(one.waste(places[:, :2]), 0.0, apart(places, one.laid.point))
    # where it goes in and comes out, also in the waste: there the whole blade is to be on the curve
    row = np.tile(np.repeat(np.arange(len(along)), BLADE_PLACES)[inside.ravel()], 2)
    ends = [0] * (span.begins != "piece") + [len(along) - 1] * (span.ends != "piece")
    some = np.isin(row, ends)
    off[some] = apart(places[some], one.laid.point) if some.any() else off[some]
    k, most = int(np.argmax(off)), BESIDE_SHARE * op.shape_tol_mm * MM
    if off[k] > most:
        x, y, _ = places[k] / MM
        what = f"{slot.name}: at ({x:.1f}, {y:.1f}) mm the blade, {(own.end + near) / MM:.1f} mm wide in the "
        what += f"sheet, is {off[k] / MM:.2f} mm off its curve; allowed: {most / MM:.2f} mm"
        hint = "take a narrower blade, or less below_mm, draw a wider bend, or a sharp corner, at which it "
        hint += f"is lifted, or take shape_tol_mm: {np.ceil(200.0 * off[k] / MM) / 100.0:g}"
        value, limit = float(off[k]) / MM, most / MM
        raise refusal("trim.corner", what, value=value, limit=limit, unit="mm", hint=hint)


@dataclasses.dataclass(frozen=True)
class Turning:
    """M places in the air on the way from one stretch to the next, over which a knife turns: ``tip``,
    ``axis`` (M, 3) and ``heading`` (M,) [rad]."""

    tip: FloatArray
    axis: FloatArray
    heading: FloatArray


def turning(
    one: tuple[FloatArray, FloatArray, float], other: tuple[FloatArray, FloatArray, float]
) -> Turning:
    """From tip, axis (3,) and heading [rad] over the end of a stretch to those over the next: headings count
    on, so that a knife turns back what it has turned in the sheet."""
    turn = other[2] - one[2]
    count = max(int(np.ceil(abs(turn) / TURN_STEP - 1e-9)) - 1, 0)
    share = (np.arange(count) + 1.0) / (count + 1.0)
    tip = one[0] + share[:, None] * (other[0] - one[0])
    axis = one[1] + share[:, None] * (other[1] - one[1])
    return Turning(np.asarray(tip), unit(np.asarray(axis)), np.asarray(one[2] + share * turn))
